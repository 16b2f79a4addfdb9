"""Error against run time of the demos: the shared report with numbers that are known, every demo's own, small, and the page
that says what to choose against the tables that it was written from."""
import csv
import os
import re
from pathlib import Path

import numpy as np
import pytest

from demos import (
    bed_report,
    contacts_only,
    flow_past_cylinder,
    minimum_fluidisation,
    mri_bed,
    own_weak_form,
    reports,
    salzman_report,
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


DEMOS = Path(__file__).resolve().parents[1] / "demos"
TABLES = {  # file: module, report
    "contacts_only_report.csv": (contacts_only, "discharge"), "own_weak_form_report.csv": (own_weak_form, "fall"),
    "flow_past_cylinder_steady_report.csv": (flow_past_cylinder, "steady"),
    "flow_past_cylinder_shedding_report.csv": (flow_past_cylinder, "shedding"),
    "minimum_fluidisation_report.csv": (minimum_fluidisation, "ramp"), "mri_bed_report.csv": (mri_bed, "voidage"),
    "turbulent_channel_report.csv": (turbulent_channel, "friction"),
    "sedimenting_suspension_report.csv": (sedimenting_suspension, "slip")}


def number(text):
    """A number where it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def rows_of(name):
    """Rows of a table of the demos."""
    with open(DEMOS / name) as file:
        return [{k: number(v) for k, v in row.items()} for row in csv.DictReader(file)]


def page():
    """Rows of the page "choosing a scheme, a mesh and a step", by the file that each links: choose, error, cost, dearest."""
    text = (DEMOS / "README.md").read_text().split("## Choosing a scheme, a mesh and a step")[1]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if ".csv](" in line]
    return {re.search(r"\((.*\.csv)\)", cells[-1])[1]: cells for cells in lines if len(cells) == 8}


def near(text, value):
    """Whether the first number of a text is a value as rounded there."""
    found = re.search(r"[0-9.]+", text)[0].rstrip(".")
    return abs(float(found) - value) <= 0.5001 * 10.0 ** -len(found.partition(".")[2]) + 0.02 * value * ("." not in found)


@pytest.mark.parametrize("file", TABLES)
def test_tables_are_those_of_the_reports(file):
    """Every table has the runs of its command, every error its reference; the page says what the report recommends."""
    module, which = TABLES[file]
    report, rows, line = module.REPORTS[which], rows_of(file), page()[file]
    assert len(rows) == len(report.settings)
    for row, setting in zip(rows, report.settings):
        for name, value in setting.items():
            value = "x".join(map(str, value)) if isinstance(value, tuple) else value
            assert row[name] == (str(value) if isinstance(value, bool) else value)
        for name, right in report.quantities.items():
            there = row[f"{name}_reference"]
            assert there == (rows[report.reference][name] if right is None else right if isinstance(right, float) else there)
            assert row[f"{name}_error"] == pytest.approx(abs(row[name] - there) / (abs(there) or 1.0), rel=1e-9, abs=1e-12)
    varied = list(dict.fromkeys(name for setting in report.settings for name in setting))
    words, best = reports.in_words(rows, report, varied)
    assert ("nearest" in words) == ("nearest" in line[3])
    error, (_, spread) = rows[best]["error"], reports.chance(rows, report)
    assert near(line[4], 100 * error if "%" in line[4] else error)
    if spread:
        assert near(line[4].split("seed: ")[1], 100 * spread if "%" in line[4] else rows[1]["error"])
    assert near(line[5], rows[best]["processor_s"]) and near(line[6], max(r["processor_s"] for r in rows))


def test_what_the_page_chooses():
    """The options that it names are those of the recommended runs."""
    lines = page()
    assert set(lines) == {*TABLES, "bed_report.csv", "jet_in_cross_flow.csv", "salzman_report.csv"}
    for file, words in (("contacts_only_report.csv", "{stiffness:g} N/m, {steps_per_contact:g} steps"),
                        ("flow_past_cylinder_steady_report.csv", "{around:g} segments, {time_step:g} s"),
                        ("own_weak_form_report.csv", "{cells:g} cells, {time_step:g}")):
        module, which = TABLES[file]
        rows = rows_of(file)
        best = rows[reports.in_words(rows, module.REPORTS[which], list(module.REPORTS[which].settings[0]))[1]]
        assert words.format(**best).split(", ")[0] in lines[file][3]
    for file, rows in ((f, rows_of(f)) for f in lines):
        assert (DEMOS / file).with_suffix(".png").exists() or file == "jet_in_cross_flow.csv"
        assert rows


def test_the_bed_and_the_jets():
    """Their reports have tables of their own kind."""
    lines, beds = page(), rows_of("bed_report.csv")
    assert [(r["time_step_s"], r["steps_per_contact"], r["cell_size_m"]) for r in beds] == list(bed_report.SETTINGS)
    best, line = bed_report.recommended(beds), lines["bed_report.csv"]
    assert line[3] == "{:g} ms, {:g} steps, {:g} mm".format(
        1e3 * best["time_step_s"], best["steps_per_contact"], 1e3 * best["cell_size_m"])
    assert near(line[4], 100 * max(abs(d) for d, _ in bed_report.deviations(best, beds[0]).values()))
    assert near(line[5], best["seconds"]) and near(line[6], max(r["seconds"] for r in beds))
    jets, line = [r for r in rows_of("jet_in_cross_flow.csv") if r["cells"] == 12600], lines["jet_in_cross_flow.csv"]
    exact = next(r for r in jets if (r["coupling"], r["time_step_s"]) == ("conservative", 4.9e-5))
    good = [r for r in jets if r["stable"] == "True" and abs(r["penetration"] / exact["penetration"] - 1) < 0.05]
    best = min(good, key=lambda r: r["processor_milliseconds_per_step"] * r["steps"])
    assert line[3] == f"{best['coupling']}, {1e6 * best['time_step_s']:g} us"
    assert near(line[4], 100 * abs(best["penetration"] / exact["penetration"] - 1))
    for cell, row in ((line[5], best), (line[6], exact)):
        assert near(cell, 1e-3 * row["processor_milliseconds_per_step"] * row["steps"])
    heights, line = rows_of("salzman_report.csv"), lines["salzman_report.csv"]
    best = next(r for r in heights if (r["edges_across_nozzle"], r["coarse_graining"], r["time_step_s"]) == (3, 25, 4e-4))
    assert [(r["edges_across_nozzle"], r["coarse_graining"], r["time_step_s"], r["smoothing_length_m"] > 0)
            for r in heights] == list(salzman_report.SETTINGS)
    assert best["deviation"] < salzman_report.WITHIN and best["processor_s"] == min(
        r["processor_s"] for r in heights if r["deviation"] < salzman_report.WITHIN)
    assert near(line[4], 100 * best["deviation"]) and near(line[5], best["processor_s"])
    assert near(line[6], heights[0]["processor_s"])
