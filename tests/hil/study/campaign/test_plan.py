"""The campaign file: its rows, and its errors, each with its place."""

import json
from pathlib import Path

import jsonschema  # type: ignore[import-untyped]
import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load
from hil.app.configuration.yaml_positions import parse
from hil.study.campaign.plan import read_plan
from hil.study.campaign.row import row_configuration
from hil.study.campaign.settings import Sample, SampledAxis, schema
from tests.broad import broad
from tests.hil.study.campaign.campaigns import SMALL, written

ALL = """
kind: campaign
changes:
  plant: {faults: [{kind: payload_step, mass_kg: 10, position_m: [0, 0, 0]}]}
sample:
  method: halton
  count: 2
  axes:
    mass_kg: {key: "plant.faults[0].mass_kg", uniform: [10, 20]}
list:
  wn: {key: controller.wn_rad_s, values: [10, 20]}
  place_m: {key: ["plant.faults[0].position_m[0]", "plant.faults[0].position_m[1]"], values: [0.1, 0.2]}
grid:
  law:
    options:
      own: {}
      pd: {controller: {law: pd, kp_N_m: 1e6, kv_N_s_m: 1e5}}
  fault: {faults: {none: [], two: ["drive_gain leg=2 factor=0.9", "frames_loss probability=0.1"]}}
"""


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    text = ALL.replace("wn: {key: controller.wn_rad_s", "wn: {key: limits.condition")
    return read_plan(written(tmp_path_factory.mktemp("plan"), text))


def test_campaign_combines_every_sample_with_every_list_row_and_grid_point(plan):
    rows = [plan.values(k) for k in range(len(plan))]
    (a, b) = dict.fromkeys(row.pop("mass_kg") for row in rows)
    listed = [{"wn": 10, "place_m": 0.1}, {"wn": 20, "place_m": 0.2}]
    grid = [{"law": law, "fault": fault} for law in ("own", "pd") for fault in ("none", "two")]
    assert rows == [one | other for _ in (a, b) for one in listed for other in grid]
    assert {10 <= a <= 20, 10 <= b <= 20, a != b} == {True}


def test_a_row_has_the_configuration_of_its_axis_values(plan):
    """Row 7: the first sample, the second line of the list, law pd, two additional faults."""
    c = row_configuration(plan.job(7))
    shipped = load("virtual")
    assert c.controller.model_dump() == {**c.controller.model_dump(), "law": "pd", "kp_N_m": 1e6}
    assert c.plant is not None
    assert [fault.model_dump(mode="json", exclude_unset=True) for fault in c.plant.faults] == [
        {"kind": "payload_step", "mass_kg": plan.values(7)["mass_kg"], "position_m": [0.2, 0.2, 0.0]},
        {"kind": "drive_gain", "leg": 2, "factor": 0.9},
        {"kind": "frames_loss", "probability": 0.1},
    ]
    assert c.limits == shipped.limits.model_copy(update={"condition": 20.0})
    assert c.platform == shipped.platform


def test_rows_of_one_sample_share_a_seed_which_the_key_seed_overrides(plan, tmp_path):
    assert [plan.job(k).seed for k in range(len(plan))] == [0] * 8 + [1] * 8
    text = "kind: campaign\ngrid: {s: {key: seed, values: [4, 9223372036854775807]}}\nduration_s: 1\n"
    seeded = read_plan(written(tmp_path, text))
    assert [seeded.job(k).seed for k in range(2)] == [4, 2**63 - 1]


def axis(**words):
    return SampledAxis.model_validate({"key": "x.y"} | words)


@pytest.mark.parametrize("method", broad(["sobol", "latin_hypercube"], 1))
def test_sixteen_sample_points_have_one_in_each_sixteenth_of_every_axis(method):
    """A net of base 2, and a Latin hypercube: https://docs.scipy.org/doc/scipy/reference/stats.qmc.html."""
    axes = {name: axis(uniform=(0.0, 16.0)) for name in "abc"}
    points = np.array(Sample(method=method, count=16, seed=5, axes=axes).draw())
    assert (np.sort(np.floor(points), axis=0) == np.arange(16.0)[:, None]).all()


def test_distributions_have_the_quantiles_of_their_names():
    assert axis(loguniform=(1e-6, 1e-2)).value_at(0.25) == pytest.approx(1e-5)
    assert axis(uniform=(-2.0, 6.0)).value_at(0.25) == 0.0
    whole = [axis(integers=(3, 5)).value_at(u) for u in np.linspace(0.0, 1.0, 301)]
    assert [whole.count(k) for k in (2, 3, 4, 5, 6)] == [0, 100, 100, 101, 0]
    names = axis(values=["a", "b"])
    assert [names.value_at(u) for u in (0.0, 0.49, 0.5, 1.0)] == ["a", "a", "b", "b"]


AXIS = "{key: x.y, values: [1]}"
SENSED = "changes: {sensors: {tracker: {rate_Hz: 200}}}"


def sampled(words):
    """A section with one sampled axis."""
    return f"sample: {{method: sobol, count: 2, axes: {{a: {{key: x.y, {words}}}}}}}"


WRONG = [
    ("", ":1:1: no swept keys, allowed: a section sample, list or grid"),
    ("grid: {a: {key: plant.drives.encoder_resolution, values: [1]}}", ":2:8: grid.a: plant.drives.encoder_resolution"),
    ("grid: {a: {key: controller.wn_rad_s, values: [20, -1]}}", ":2:8: grid.a: controller.wn_rad_s: out of range"),
    ("grid:\n  a: {key: 'plant.faults[0].mass_kg', values: [1]}", ":3:3: grid.a: plant.faults[0].mass_kg: plant.faults has no"),
    ("grid:\n  a: {key: loop.rate_Hz.x, values: [1]}", ":3:3: grid.a: loop.rate_Hz.x: loop.rate_Hz is a plain value"),
    ("grid:\n  a: {key: 'plant faults', values: [1]}", ":3:3: grid.a: plant faults: malformed key"),
    ("grid:\n  a: {faults: {jump: ['encoder_jmp leg=1']}}", "unknown kind 'encoder_jmp', did you mean encoder_jump?"),
    ("grid:\n  a: {key: x.y, values: [1], options: {b: {}}}", "grid.a: allowed: exactly one of values, options, faults"),
    ("grid: {a: {values: [1]}}", "key is missing, allowed: a key of the configuration"),
    ("list:\n  a: {key: x.y, values: [1]}\n  b: {key: x.z, values: [1, 2]}", "list: allowed: axes with equally many values"),
    (f"grid: {{a: {AXIS}}}\nlimits: {{peak_leg_eror_mm: {{max: 1}}}}", ":3:28: limits.peak_leg_eror_mm: unknown metric"),
    (f"grid: {{ended: {AXIS}}}", "grid.ended: already a column of the table"),
    (f"configuration: nosuch\ngrid: {{a: {AXIS}}}", ":2:1: configuration: nosuch: no such file; shipped"),
    (f"changes: {{loop: {{rate: 5}}}}\ngrid: {{a: {AXIS}}}", ":2:1: changes: loop.rate: "),
    (f"grid:\n  a: {AXIS}\n  b: {{key: [x.z, x.y], values: [1]}}", "grid.b: x.y is also swept by a"),
    (f"grid: {{a: {AXIS}}}\nlimits: {{travel_mm: {{max: 1}}}}", "limits.travel_mm: not measured in runs that end"),
    (f"grid: {{a: {AXIS}}}\nlimits: {{tracked_s: {{min: 1, max: 0.1}}}}", ":3:21: limits.tracked_s: min is above max"),
    (f"{SENSED}\ngrid: {{a: {{key: plant, values: [null]}}}}", "plant"),
    ("grid: {a: {key: [seed], values: [true]}}", "seed: allowed: integers from 0 to 2**63 - 1, given: True"),
    ("list: {a: {key: seed, values: [1, -1]}}", "seed: allowed: integers from 0 to 2**63 - 1, given: -1"),
    (f'grid: {{"a b": {AXIS}}}', "2:8: grid.a b: wrong form"),
    (sampled("normal: {mean: 3, std: 1, min: 9, max: 0}"), "[low, high] with low < high, given: [9.0, 0.0]"),
    (sampled("loguniform: [0, 1]"), "sample.axes.a.loguniform[0]: out of range"),
    (
        sampled("uniform: [0, 1]").replace("count: 2", "count: 10000000") + "\nlist: {l: {key: x.z, values: [1, 2]}}",
        "20000000 rows, allowed: up to 10000000",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_an_invalid_campaign_is_refused_with_place_and_allowed_values(tmp_path, text, message):
    path = written(tmp_path, f"kind: campaign\n{text}\n")
    with pytest.raises(ConfigurationError) as error:
        read_plan(path)
    assert message in str(error.value)
    assert str(path) in str(error.value) or "--fault" in message
    assert "row 0" not in str(error.value)  # rows are not the user's yet


def test_minimum_and_maximum_of_a_limit_may_be_equal(tmp_path):
    """For runs that must end in a fault."""
    text = "kind: campaign\ngrid: {a: {key: seed, values: [1]}}\nlimits: {faulted: {min: 1, max: 1}}\n"
    limit = read_plan(written(tmp_path, text)).settings.kept["faulted"]
    assert [limit.passed_by(value) > 0.0 for value in (0, 1, None)] == [True, False, True]


def test_error_of_one_campaign_axis_is_reported_only_for_that_axis(tmp_path):
    text = """
    kind: campaign
    grid:
      a: {key: plant.drives.encoder_resolution, values: [1]}
      b: {key: loop.rate_Hz, values: [1000]}
      c: {faults: {x: [encoder_jmp leg=1]}}
    """
    with pytest.raises(ConfigurationError) as error:
        read_plan(written(tmp_path, text))
    first, second = error.value.problems
    assert "grid.a: plant.drives.encoder_resolution: unknown key" in first
    assert "grid.c.faults.x: --fault" in second  # which of the options or faults, too


def test_an_axis_may_set_a_key_that_another_axis_creates(tmp_path):
    text = """
    kind: campaign
    grid:
      law: {options: {pd: {controller: {law: pd, kp_N_m: 1e6, kv_N_s_m: 1e5}}}}
      kp_N_m: {key: controller.kp_N_m, values: [1e6, 2e6]}
    """
    plan = read_plan(written(tmp_path, text))
    assert [row_configuration(plan.job(k)).controller.model_dump()["kp_N_m"] for k in range(2)] == [1e6, 2e6]


def emulated(plan, row):
    """Section `plant` of a row's configuration."""
    plant = row_configuration(plan.job(row)).plant
    assert plant is not None
    return plant


def test_campaign_axis_inside_the_value_of_another_axis_changes_only_its_own_row(tmp_path):
    text = """
    kind: campaign
    duration_s: 0.05
    changes: {plant: {faults: [{kind: payload_step, mass_kg: 10, position_m: [0, 0, 0]}]}}
    grid:
      place: {key: "plant.faults[0].position_m", values: [[0, 0, 0], [0, 0, 0.1]]}
      x_m: {key: "plant.faults[0].position_m[0]", values: [0.2, 0.3]}
    """
    plan = read_plan(written(tmp_path, text))
    places = [emulated(plan, k).faults[0].model_dump()["position_m"] for k in range(4)]
    assert places == [(0.2, 0, 0), (0.3, 0, 0), (0.2, 0, 0.1), (0.3, 0, 0.1)]
    assert [plan.values(k)["place"] for k in (1, 3)] == [[0, 0, 0], [0, 0, 0.1]]


def test_campaign_rows_never_wait_for_an_operator(tmp_path):
    """Otherwise it would wait at the start of its path, without an error, and pass."""
    text = SMALL + "changes: {operator: {start: asked, deadman_s: 0.2, stays: true}}\n"
    operator = row_configuration(read_plan(written(tmp_path, text)).job(0)).operator
    assert (operator.start, operator.deadman_s, operator.stays) == ("automatic", None, False)


def test_the_committed_schema_is_current_and_accepts_shipped_campaigns():
    """Update: python -c 'from hil.study.campaign.settings import schema; print(schema(), end="")' > its file."""
    folder = Path(__file__).parents[4] / "configs/campaigns"
    committed = (folder / "campaign.schema.json").read_text()
    assert committed == schema()
    check = jsonschema.Draft202012Validator(json.loads(committed))
    shipped = sorted(folder.glob("*.yaml"))
    assert len(shipped) == 3
    for path in shipped:
        shipped_text = path.read_text()
        assert shipped_text.startswith("# yaml-language-server: $schema=campaign.schema.json\n")
        check.validate(parse(shipped_text).value)
        assert (len(read_plan(path)), read_plan(path).name) == (500, path.stem)
    with pytest.raises(jsonschema.ValidationError, match="sobl"):
        check.validate(parse(shipped_text.replace("method: sobol", "method: sobl")).value)
