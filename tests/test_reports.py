"""Error against run time of the demos: the shared report with numbers that are known, and every demo's own, small."""
import csv
import os

import numpy as np
import pytest

from demos import (
    contacts_only,
    flow_past_cylinder,
    minimum_fluidisation,
    mri_bed,
    own_weak_form,
    reports,
    sedimenting_suspension,
    turbulent_channel,
)


def rule(step=0.1, order=2, seed=1, end_time=1.0, output=None, progress=True):
    """A run whose answer is 2 less the step to its order, at a cost of a step each."""
    value = 2 - step ** order + 1e-3 * (seed - 1)
    return {"value": value, "right": 2.0, "off": value - 2, "stable": step < 1, "wall_time": end_time / step,
            "processor_time": 2 * end_time / step}


def table(folder):
    """Rows of the report's CSV, numbers where they are numbers."""
    with open(folder + "/report.csv") as file:
        return list(csv.DictReader(file))


SETTINGS = ({"step": 0.01}, {"step": 0.1}, {"step": 0.2}, {"step": 0.2, "order": 1}, {"step": 2.0})


def test_errors_costs_and_the_setting_to_choose(folder):
    """Against the first run, against a number, against another value of the run; the cheapest that is near enough wins."""
    report = reports.Report(SETTINGS, {"value": None, "off": 0.0}, within=0.05)
    summary = reports.run(rule, report, folder)
    rows = table(folder)
    assert [float(r["error"]) for r in rows] == pytest.approx([1e-4, 1e-2, 0.04, 0.2, np.inf])  # of 0: the number itself
    assert float(rows[1]["value_error"]) == pytest.approx((0.01 - 1e-4) / (2 - 1e-4))
    assert [r["order"] for r in rows] == ["2", "2", "2", "1", "2"]  # what a setting leaves out is the demo's own
    assert summary["recommended"] == 2
    assert summary["in_words"].startswith("Choose 0.2, 2 (step, order): the cheapest within 5 %")
    assert float(rows[2]["processor_s"]) == 10 and float(rows[2]["wall_s"]) == 5
    published = reports.run(rule, report._replace(quantities={"value": "right"}, within=1e-6), folder, {"end_time": 3.0})
    assert published["recommended"] == 0 and "nearest, but not within 0.0001 % of the published" in published["in_words"]
    assert float(table(folder)[1]["processor_s"]) == 60 and os.path.getsize(folder + "/report.png") > 0


def test_another_seed_shows_what_chance_does(folder):
    """Errors below those of another start count as none, and the repetition itself is never chosen."""
    settings = ({"step": 0.01, "seed": 1}, {"step": 0.01, "seed": 2}, {"step": 0.03, "seed": 1}, {"step": 0.1, "seed": 1})
    summary = reports.run(rule, reports.Report(settings, {"value": None}, within=1e-5), folder)
    assert summary["recommended"] == 2 and "another seed alone: 0.05 %" in summary["in_words"]


def test_command_line(folder, capsys):
    """Without the option one run, with it the report; options that are given hold for all of its runs."""
    import argparse

    def parser():
        p = argparse.ArgumentParser()
        p.add_argument("--step", type=float, default=0.1)
        p.add_argument("--end-time", type=float, default=1.0)
        p.add_argument("--output", default="out/rule")
        return p
    known = {"steps": reports.Report(SETTINGS, {"value": 2.0}, {"end_time": 5.0})}
    assert reports.start(rule, parser(), known, ["--step", "0.5"])["value"] == 1.75
    assert reports.start(rule, parser(), known, ["--report", "--end-time", "2", "--output", folder])["runs"] == 5
    assert float(table(folder)[0]["wall_s"]) == 200 and "in_words" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        reports.start(rule, parser(), known, ["--report", "cells"])


SMALL = {  # module, report, two settings of it, what all share
    "silo": (contacts_only, "discharge", (2, 6), {"particles": 300, "settle_time": 0.05, "end_time": 0.15}),
    "cylinder, steady": (flow_past_cylinder, "steady", (4, 6), {"end_time": 1.6}),
    "cylinder, shedding": (flow_past_cylinder, "shedding", (6, 7), {"size": 0.1, "growth": 0.3, "end_time": 0.2}),
    "ramp": (minimum_fluidisation, "ramp", (3, 4), {"number": 500, "ramp_time": 0.04, "settle_time": 0.01}),
    "measured bed": (mri_bed, "voidage", (4, 5), {"end_time": 0.01, "average_from": 0.0}),
    "own weak form": (own_weak_form, "fall", (6, 7), {"particles": 60, "end_time": 4e-3}),
    "channel": (turbulent_channel, "friction", (4, 7), {"end_time": 4.0}),
    "suspension": (sedimenting_suspension, "slip", (4, 5), {"box": (24.0,) * 3, "cells": (3,) * 3, "end_time": 0.01}),
}


@pytest.mark.parametrize("name", SMALL)
def test_report_of(folder, name):
    """Two of a demo's own settings, a moment each: every quantity is in the table with its reference, and so is the cost."""
    module, which, chosen, same = SMALL[name]
    report = module.REPORTS[which]
    assert 5 <= len(report.settings) <= 8
    summary = reports.run(module.main, report._replace(settings=tuple(report.settings[k] for k in chosen)), folder,
                          same | {"progress": False})
    rows = table(folder)
    assert len(rows) == summary["runs"] == 2 and summary["recommended"] in (0, 1)
    for row in rows:
        assert float(row["processor_s"]) > 0 and float(row["wall_s"]) > 0
        for quantity, right in report.quantities.items():
            assert row[quantity] != "" and float(row[quantity + "_error"]) >= 0
            assert not isinstance(right, float) or float(row[quantity + "_reference"]) == right
    assert 0 < os.path.getsize(folder + "/report.png") < 100_000
