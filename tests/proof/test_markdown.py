"""Tables in pages: between their marks and nowhere else."""

import pytest

from buggy_rl.proof.markdown import fill, marked, table, table_marks, with_table

PAGE = "before\n<!-- one: begin -->\nold\nold\n<!-- one: end -->\nafter\n"


def test_marks_part_a_text():
    before, between, behind = marked(PAGE, "one")
    assert (before, between, behind) == ("before\n", "old\nold\n", "\nafter\n")
    assert "".join((before, table_marks("one")[0], between, table_marks("one")[1], behind)) == PAGE


def test_what_is_filled_in_stands_between_its_marks():
    text = with_table(PAGE, "one", table(["a"], [[1]]))
    assert text == (
        "before\n<!-- one: begin -->\n| a |\n| --- |\n| 1 |\n<!-- one: end -->\nafter\n"
    )
    assert with_table(text, "one", "old\nold") == PAGE


@pytest.mark.parametrize("text", ["nothing", "<!-- one: begin -->\n", "<!-- one: end -->"])
def test_a_text_without_both_marks_is_refused(text):
    with pytest.raises(ValueError, match="no lines <!-- one: begin --> and <!-- one: end -->"):
        with_table(text, "one", "new")


def test_a_page_gets_the_tables_for_which_it_has_marks(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    fill(page, {"one": "new", "two": "other"})
    assert page.read_text() == with_table(PAGE, "one", "new")
    with pytest.raises(ValueError, match="has none of the lines <!-- two: begin -->"):
        fill(page, {"two": "other"})
