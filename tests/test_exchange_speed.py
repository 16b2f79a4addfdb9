"""The demo of the exchange's speed, small."""
from demos.benchmarks import exchange_speed


def test_exchange_speed(folder):
    out = exchange_speed.main(slices=(0.05,), particles=(1000, 2000), steps=2, output=folder, progress=False)
    beds = [key for key in out if key.startswith("nanoseconds_of_exchange_bed")]
    assert len(beds) == 1 and out[beds[0]] > 0 and out["nanoseconds_of_exchange_suspension_2000"] > 0
    assert out["cells_suspension_2000"] == 6 * 4 ** 3 and 0 < out["share_of_fluid_suspension_1000"] < 1
    assert all(out[key] < 1e-12 for key in out if key.startswith("momentum_imbalance"))


def test_drag_and_mapping_make_the_whole(folder):
    out = exchange_speed.main(slices=(), particles=(1000,), steps=1, output=folder, progress=False)
    parts = out["nanoseconds_of_mapping_suspension_1000"] + out["nanoseconds_of_drag_suspension_1000"]
    assert abs(parts - out["nanoseconds_of_exchange_suspension_1000"]) < 1e-9 * parts and "growth_exponent" not in out
