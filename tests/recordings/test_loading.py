"""Many recordings: a refused one does not stop the others."""

import runpy
import subprocess
import sys

import pytest

from buggy_rl.recordings import RecordingError, load_recordings


@pytest.fixture
def folder(make_drive, tmp_path):
    """good.csv, bad.csv, sub/good.parquet, and files that are no recordings."""
    (tmp_path / "sub").mkdir()
    good = make_drive(seconds=4, noise=2e-4)
    good.to_csv(tmp_path / "good.csv", index=False)
    good.assign(yaw=60 * good.yaw).to_csv(tmp_path / "bad.csv", index=False)
    good.to_parquet(tmp_path / "sub" / "good.parquet")
    (tmp_path / "README.md").write_text("text")
    (tmp_path / ".good.csv.tmp").write_text("half")
    return tmp_path


def test_a_folder_gives_its_good_recordings_and_the_errors_of_the_others(folder):
    recordings, refusals = load_recordings(folder)
    assert [r.source for r in recordings] == [
        str(folder / "good.csv"),
        str(folder / "sub" / "good.parquet"),
    ]
    (refusal,) = refusals
    assert isinstance(refusal, RecordingError)
    assert refusal.file == str(folder / "bad.csv")
    assert str(refusal).startswith(f"recording {folder / 'bad.csv'}, row ")


def test_recordings_of_one_name_are_prefixed_by_their_folder(folder):
    recordings, _ = load_recordings(folder)
    assert [r.name for r in recordings] == [f"{folder.name}/good", "sub/good"]


def test_files_folders_and_patterns_mix_and_each_recording_is_read_once(folder):
    paths = [folder / "good.csv", f"{folder}/*.csv", f"{folder}/**/*.parquet", str(folder)]
    recordings, refusals = load_recordings(paths)
    assert len(recordings) == 2
    assert len(refusals) == 1


@pytest.mark.parametrize("name", ["d [1]", "drive 1, fast", "a#b", "x{y}"])
def test_names_may_have_brackets_commas_and_spaces(name, folder):
    (folder / "sub").rename(folder / name)
    paths = [folder / name / "good.parquet", f"{folder / name}/*.parquet", folder / name]
    for path in paths:
        recordings, refusals = load_recordings(path)
        assert refusals == []
        assert [r.source for r in recordings] == [str(folder / name / "good.parquet")]


@pytest.mark.parametrize("path", ["missing.csv", "missing/*.csv", "README.md", "empty"])
def test_a_path_without_a_recording_is_refused(path, folder):
    (folder / "empty").mkdir()
    recordings, (refusal,) = load_recordings(f"{folder}/{path}")
    assert recordings == []
    assert path in str(refusal)


def test_a_wrong_column_map_is_no_error_of_a_recording(folder, tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.yaml"):
        load_recordings(folder, columns=tmp_path / "nowhere.yaml")


@pytest.fixture
def check(repository, monkeypatch, capsys):
    """Runs scripts/check_recordings.py in this process: exit code, stdout, stderr."""
    path = repository / "scripts" / "check_recordings.py"

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", [str(path), *map(str, arguments)])
        code = runpy.run_path(str(path))["main"]()
        return code, *capsys.readouterr()

    return run


def test_the_script_prints_which_recordings_are_usable_and_exits_with_its_code(folder, check):
    code, out, _ = check(folder)
    assert code == 1
    assert "2 recordings usable, 8.0 s; 1 refused" in out
    assert f"refused: recording {folder / 'bad.csv'}, row " in out
    assert check(folder / "good.csv", "dt=0.02")[0] == 0
    assert check(folder / "bad.csv")[0] == 2
    code, _, err = check(folder, "columns=nowhere.yaml")
    assert code == 2
    assert "nowhere.yaml" in err


def test_the_script_reports_what_was_cut(make_drive, write, check):
    path = write(make_drive(seconds=4, noise=2e-4).drop(index=range(200, 220)))
    assert "  row 200, column t: rows missing before it" in check(path)[1]


def test_the_script_prints_what_matters_without_being_asked(make_drive, write, check):
    turned = make_drive(noise=2e-4).drop(columns=["vx", "vy", "yaw_rate"])
    path = write(turned.assign(yaw=turned.yaw + 0.5))
    out = check(path)[1]
    assert "if the tracker is mounted so, state mount: {yaw: 0." in out
    assert "derived from the pose" not in out
    assert "derived from the pose" in check(path, "--notes")[1]


@pytest.mark.parametrize(
    ("word", "says"),
    [("colums=map.yaml", "did you mean columns=?"), ("dt=fast", "dt=fast: write a number")],
)
def test_the_script_refuses_a_mistyped_setting(word, says, folder, check, capsys):
    with pytest.raises(SystemExit, match="2"):
        check(folder, word)
    assert says in capsys.readouterr().err


def test_help_needs_neither_torch_nor_pandas(repository):
    code = (
        "import runpy, sys; sys.argv = ['check', '--help']\n"
        "try: runpy.run_path(sys.path.pop(0), run_name='__main__')\n"
        "except SystemExit: print(sorted({'torch', 'pandas'} & set(sys.modules)))"
    )
    path = str(repository / "scripts" / "check_recordings.py")
    code = code.replace("sys.path.pop(0)", repr(path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("[]\n")


def test_the_package_is_imported_without_torch_or_pandas():
    code = "import buggy_rl.recordings, sys; print({'torch', 'pandas'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
