"""What the fault campaign reads off the log of the wheels, and that it resumes."""

import importlib
import math

import pytest

from buggy_rl.proof.markdown import marked

DRIVE, COAST, NEUTRAL = (0.2, 0.3), (-1.0, 0.3), (-1.0, 0.0)


@pytest.fixture(scope="module")
def faults(request):
    """The modules of the campaign, by name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(request.config.rootpath / "benchmarks")
        yield lambda name: importlib.import_module(f"faults.{name}")


def log(*entries):
    """Commands every 10 ms from t = 0.99 on."""
    return [(0.99 + 0.01 * k, *command) for k, command in enumerate(entries)]


@pytest.mark.parametrize(
    ("entries", "cut", "neutral"),
    [
        ([DRIVE, DRIVE, NEUTRAL, NEUTRAL], 10, 10),
        ([DRIVE, DRIVE, COAST, COAST, NEUTRAL], 10, 30),
        ([DRIVE, COAST, DRIVE, COAST, NEUTRAL], 20, 30),  # it drove once more
        ([DRIVE, DRIVE, NEUTRAL, DRIVE], 10, 10),  # armed again afterwards
        ([NEUTRAL, NEUTRAL], 0, 0),
        ([DRIVE, DRIVE, COAST], 10, math.inf),
    ],
)
def test_a_reaction_counts_until_the_last_drive_and_until_neutral(faults, entries, cut, neutral):
    found = faults("injection").reaction(1.0, log(*entries))
    assert (found.cut, found.neutral) == (pytest.approx(cut), pytest.approx(neutral))


def test_wheels_that_never_stop_driving_count_for_ever(faults):
    assert faults("injection").reaction(1.0, log(DRIVE, DRIVE, DRIVE)).cut == math.inf


def test_missing_time_counts_readings_that_arrived_and_are_in_no_whole_row(faults, tmp_path):
    campaign = faults("campaign")
    file = tmp_path / "drive_00.csv"
    rest = "," * campaign.CELLS
    rows = [f"{0.01 * k:.6f}{rest}" for k in range(10) if k != 4]
    file.write_text("header\n" + "\n".join(rows) + "\n0.1000")  # the last line is torn
    file.with_suffix(".json").write_text('{"origin": 50.0}')
    sent = [50.0 + 0.01 * k for k in range(-3, 11)]  # three before the recording began
    assert campaign.missing_time(file, sent) == pytest.approx(0.02)


def test_it_resumes_where_its_file_ends(faults, tmp_path):
    campaign = faults("campaign")
    output = tmp_path / "faults.csv"
    config = campaign.CampaignConfig(str(output), faults=["silent", "late"], times=3)
    for number in range(2):
        campaign._append(output, campaign.Injection("silent", number, 50.0, 250.0, True, 0.0))
    assert campaign.left(config) == {"silent": 1, "late": 3}
    assert "| silent | 2 | 50 | 50 | 50 | 250 |" in campaign.summary(output)


def test_an_unknown_fault_is_refused(faults):
    with pytest.raises(ValueError, match="unknown faults"):
        faults("campaign").CampaignConfig(faults=["deaf"])


def test_a_fault_that_nothing_stopped_is_never_in_the_table(faults, tmp_path):
    campaign, output = faults("campaign"), tmp_path / "faults.csv"
    for number, cut in enumerate((10.0, 20.0, math.inf)):
        campaign._append(output, campaign.Injection("silent", number, cut, cut, True, 0.0))
    assert "| silent | 3 | 20 | never | never |" in campaign.summary(output)


@pytest.mark.parametrize("page", ["docs/car.md", "benchmarks/README.md"])
def test_the_pages_have_the_table_of_the_results(faults, page, request):
    table, root = faults("table"), request.config.rootpath
    lines = table.summary(root / "benchmarks" / "results" / "car_faults.csv")
    assert marked((root / page).read_text(), table.PLACE)[1] == f"{lines}\n"


def test_the_results_name_faults_that_there_are(faults, request):
    file = request.config.rootpath / "benchmarks" / "results" / "car_faults.csv"
    names = {line.split(",")[0] for line in file.read_text().splitlines()[1:]}
    assert names <= set(faults("injection").FAULTS)


def test_a_spoilt_driver_acts_by_the_file_beside_the_socket(faults, tmp_path):
    devices = faults("devices")
    address = str(tmp_path / "car")
    spoilt = devices.Spoilt(address)
    spoilt.act()  # no file: nothing
    devices.spoil(address, "loop_raises")
    with pytest.raises(RuntimeError, match="the driver broke"):
        spoilt.act()
    devices.spoil(address, "")
    spoilt.act()
