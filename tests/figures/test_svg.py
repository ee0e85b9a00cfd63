"""SVG elements of a page."""

import pytest
from matplotlib.figure import Figure

from buggy_rl.figures.style import svg


def line(values):
    figure = Figure()
    figure.subplots().plot(values)
    return figure


def test_an_svg_element_is_labelled_scales_with_the_page_and_refers_to_nothing_outside():
    element = svg(line, [0, 1, 4], 'a "b" <c> & d')
    opening = element.partition(">")[0]
    assert 'aria-label="a &quot;b&quot; &lt;c&gt; &amp; d"' in element
    assert "viewBox" in opening
    assert " width=" not in opening
    assert "http" not in element
    assert "<style" not in element
    assert "<metadata" not in element
    assert element.rstrip().endswith("</svg>")


@pytest.mark.parametrize(("values", "same"), [([0, 1, 4], True), ([0, 2, 4], False)])
def test_equal_data_make_equal_elements(values, same):
    assert (svg(line, values, "") == svg(line, [0, 1, 4], "")) == same
