"""Options: one set of defaults, and refusals that name the option."""

from dataclasses import fields

import pytest

from buggy_rl.core.config import ConfigError, build
from buggy_rl.core.option_values import describe
from buggy_rl.visual.film.options import PictureConfig, RenderConfig


def test_a_picture_looks_the_same_from_the_command_line_and_from_python():
    assert build(RenderConfig, ["what=x"]).picture == PictureConfig()


def test_every_option_of_a_picture_can_be_given_on_the_command_line():
    assert {f.name for f in fields(PictureConfig)} <= {f.name for f in fields(RenderConfig)}
    picture = build(RenderConfig, ["what=x", "camera=top", "size=[320,240]", "inset=false"]).picture
    assert (picture.camera, list(picture.size), picture.inset) == ("top", [320, 240], False)


def test_help_explains_every_option():
    lines = list(describe("buggy_rl.visual.film.options:RenderConfig"))
    named = {line.split("=")[0].strip() for line in lines}
    assert {"what", "ghost", "output", "camera", "dimensions.wheelbase"} <= named
    assert all("\n" in line for line in lines)


@pytest.mark.parametrize(
    ("option", "said"),
    [("fps=0", "fps=0: must be above 0"), ("start=-1", "start=-1"), ("seconds=0", "seconds=0")],
)
def test_numbers_out_of_range_are_refused(option, said):
    with pytest.raises(ValueError, match=said):
        build(RenderConfig, ["what=x", option])


def test_an_unknown_camera_is_refused():
    with pytest.raises(ConfigError, match="camera"):
        build(RenderConfig, ["what=x", "camera=side"])


def test_a_size_is_two_numbers():
    with pytest.raises(ValueError, match=r"size=\[640\]: must be width and height"):
        PictureConfig(size=[640])


@pytest.mark.parametrize(
    ("ghost", "filmed"),
    [("", ["x"]), ("a", ["x", "a"]), ("[a,b]", ["x", "a", "b"]), ("[]", ["x"])],
)
def test_a_ghost_is_a_name_or_a_list_of_names(ghost, filmed):
    assert build(RenderConfig, ["what=x", f"ghost={ghost}"]).trajectories == filmed


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["ghost=3"], "must be a name or a list of names"),
        (["ghost=a", "names=[one]"], "must be 2, one for each of x, a"),
    ],
)
def test_ghosts_and_names_that_make_no_sense_are_refused(options, said):
    with pytest.raises(ValueError, match=said):
        build(RenderConfig, ["what=x", *options])


@pytest.mark.parametrize("written", ["captions=[a: b]", "captions=['a: b']", "captions=a: b"])
def test_a_caption_with_a_colon_is_taken_as_it_stands(written):
    assert build(RenderConfig, ["what=x", written]).picture.captions == ["a: b"]


def test_a_caption_that_a_file_has_as_a_mapping_is_refused_with_the_remedy(tmp_path):
    file = tmp_path / "film.yaml"
    file.write_text("what: x\ncaptions:\n- first: slow\n")
    with pytest.raises(ValueError, match="is no text; put quotes around a colon"):
        _ = build(RenderConfig, [str(file)]).picture
