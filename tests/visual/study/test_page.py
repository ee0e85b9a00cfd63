"""The page, over made-up results."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest

from buggy_rl.estimation.fit_study import RunConfig, StudyDrives
from buggy_rl.figures.style import COLOURS, MEASURED_COLOUR
from buggy_rl.visual.study.page import Made, study_page
from buggy_rl.visual.study.stages import StudyPlan, WholeStudyConfig
from tests.drives import toy_drive
from tests.visual.study import made

VOID = {"meta", "link", "img", "br", "input"}


@pytest.fixture
def html(tmp_path):
    made.write(tmp_path)
    config = WholeStudyConfig(output=str(tmp_path), title="a <b> car", runs={"MLP": RunConfig()})
    plan = StudyPlan(config, ["drive_07.csv"], Path("scripts"))
    stages = [stage for wave in plan.waves() for stage in wave]
    drives = StudyDrives(*([toy_drive(name, 300, seed=0)] for name in ("one", "two", "three")))
    return study_page(
        plan, drives, stages, Made("python scripts/study.py", "abc1234", "2026-11-23")
    )


class Checked(HTMLParser):
    """Every element is closed in order; ids and references are gathered."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given["href"]] if "href" in given else []
        self.links += [given["src"]] if "src" in given else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def text(html):
    return " ".join(re.sub(r"<(script|style).*?</\1>|<[^>]*>", " ", html, flags=re.S).split())


def test_the_page_is_well_formed_and_refers_to_nothing_outside(html):
    found = Checked(html)
    assert len(found.ids) == len(set(found.ids))
    for link in found.links:
        assert link.startswith(("#", "data:")) or link == "diagnosis/report.html"
        assert not link.startswith("#") or link[1:] in found.ids


def test_every_table_names_the_stage_that_wrote_it(html):
    sources = re.findall(r'written by stage <a href="#stage-(\w+)"', html)
    stages = ["table", "fit", "table", "policies", "diagnosis", "repair", "figures"]
    assert sources == stages
    assert 'id="stage-policy_learned_0"' in html


def test_texts_are_escaped(html):
    assert "a &lt;b&gt; car" in html
    assert "late &lt;60 ms&gt;" in html
    assert "weak &lt;b&gt;" in html


def test_it_says_what_the_stages_found(html):
    said = text(html)
    assert "mujoco, fitted , 1 s position MSE 0.00200 m²" in said
    assert "steering_dead_time, confidence 97 %" in said
    assert "dead_time: 0.06 s (0.055 to 0.065)" in said
    assert "learned: 6.0 in fitted, 12.0 in car" in said
    assert "fitted: 6.0 in learned, 12.0 in car" in said


def test_it_ends_with_the_layers_of_the_repair_and_with_the_repaired_simulator_among_all(html):
    said = text(html)
    assert "as given 0.0200 0.0800" in said
    assert "+ steering dead time 0.0040 0.0120" in said
    assert "+ 9 parameters of its own (left out) 0.0050 0.0130" in said
    assert "re-tuned alone 0.0150 0.0500" in said
    table = said[said.index("with the repaired simulator") :]
    order = [table.index(n) for n in ("repaired by the diagnosis", "mujoco, fitted", "MLP")]
    assert order == sorted(order)


def test_the_player_has_the_fitted_simulator_and_the_best_ones(html):
    content = re.search(r'<script type="application/json" id="played">(.*?)</script>', html)[1]
    first = json.loads(content)["segments"][0]
    assert list(first["made"]) == ["mujoco, fitted", "MLP", "mujoco, as shipped"]
    off = {"mujoco, fitted": 0.1, "MLP": 0.1, "mujoco, as shipped": 0.5}
    assert first["error"] == pytest.approx(off)


def test_the_player_has_the_colours_of_all_figures_and_no_two_are_alike(html):
    content = json.loads(re.search(r'id="played">(.*?)</script>', html)[1])
    shown = [*content["colours"], content["colour_measured"]]
    assert shown == [*COLOURS, MEASURED_COLOUR]
    simulators = shown[: len(content["segments"][0]["made"])]
    for colour in simulators:  # none is a grey
        channels = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        assert max(channels) - min(channels) > 50
    dark = [sum(int(c[k : k + 2], 16) for k in (1, 3, 5)) for c in content["ramp"]]
    assert dark == sorted(dark, reverse=True)
    assert "colours[i % colours.length]" in html  # lines, cars and legend take one list


@pytest.mark.parametrize(("after", "said"), [(0.0005, False), (0.003, True)])
def test_a_repair_that_makes_things_worse_is_said_to(tmp_path, after, said):
    made.write(tmp_path)
    made.table(tmp_path / "repair", {"fitted": 0.002, "repaired": after})
    config = WholeStudyConfig(output=str(tmp_path), runs={"MLP": RunConfig()})
    html = study_page(
        StudyPlan(config, [], Path("scripts")), StudyDrives([], [], []), [], Made("", "", "")
    )
    assert ("keep the fitted one" in text(html)) == said


def test_a_table_of_before_the_median_still_makes_a_page(tmp_path):
    made.write(tmp_path)
    for file in (tmp_path / "table.csv", tmp_path / "repair" / "table.csv"):
        pd.read_csv(file).drop(columns="position_median_1s").to_csv(file, index=False)
    config = WholeStudyConfig(output=str(tmp_path), runs={"MLP": RunConfig()})
    html = study_page(
        StudyPlan(config, [], Path("scripts")), StudyDrives([], [], []), [], Made("", "", "")
    )
    assert "mujoco, fitted , 1 s position MSE 0.00200 m²" in text(html)


@pytest.mark.parametrize(
    ("diagnosed", "best"), [("fitted", "mujoco, fitted"), ("shipped", "repaired by the diagnosis")]
)
def test_a_repair_is_the_most_accurate_only_on_recordings_that_it_has_not_seen(
    tmp_path, diagnosed, best
):
    made.write(tmp_path)
    config = WholeStudyConfig(output=str(tmp_path), runs={"MLP": RunConfig()}, diagnosed=diagnosed)
    html = study_page(
        StudyPlan(config, [], Path("scripts")), StudyDrives([], [], []), [], Made("", "", "")
    )
    assert f"Most accurate simulator on held-out recordings: {best} ," in text(html)


@pytest.mark.parametrize(("confidence", "said"), [(0.02, False), (0.3, True)])
def test_an_improbable_name_is_not_said_where_something_has_no_name(tmp_path, confidence, said):
    made.write(tmp_path)
    answer = made.ANSWER | {"verdict": "unknown_physics"}
    answer["effects"] = [made.ANSWER["effects"][0] | {"confidence": confidence}]
    (tmp_path / "diagnosis" / "diagnosis.json").write_text(json.dumps(answer))
    config = WholeStudyConfig(output=str(tmp_path), runs={"MLP": RunConfig()})
    html = study_page(
        StudyPlan(config, [], Path("scripts")), StudyDrives([], [], []), [], Made("", "", "")
    )
    assert ("steering_dead_time, confidence" in text(html)) == said


def test_a_picture_too_large_for_the_page_is_left_out(html):
    assert "Raw and filtered velocities" in text(html)
    assert "Recorded velocities" not in text(html)


def test_without_policies_the_page_says_so(tmp_path):
    made.write(tmp_path)
    (tmp_path / "policies" / "policies.csv").unlink()
    config = WholeStudyConfig(output=str(tmp_path), runs={"MLP": RunConfig()})
    plan = StudyPlan(config, [], Path("scripts"))
    html = study_page(plan, StudyDrives([], [], []), [], Made("", "", ""))
    assert "No policies were trained" in html
