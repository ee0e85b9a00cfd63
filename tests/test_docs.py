"""The pages: few, linked, named rightly by the code, and in the words of the glossary."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.glob("*.md")), ROOT / "README.md", ROOT / "GLOSSARY.md"]
LINKED = [*PAGES, ROOT / "benchmarks" / "README.md"]
GLOSSARY = (ROOT / "GLOSSARY.md").read_text()
ROW = r"^\| ([a-z ]+) \| (.+?) \| ([a-z, ]*)\|$"
WORDS = [row for row in re.findall(ROW, GLOSSARY, re.M) if row[0] != "word"]
MOST_PAGES, MOST_LINES, MOST_WORDS = 11, 200, 25
CODE = ("src", "tests", "scripts", "benchmarks", "configs", "examples", "Makefile")
TEXT = (".py", ".yaml", ".json", ".md", "")


def without_code(text: str) -> str:
    """The prose of a page: no blocks, no code within a line."""
    lines = [line for line in blocks_out(text).splitlines() if not line.startswith("    ")]
    return re.sub(r"`[^`\n]*`", "", "\n".join(lines))


def blocks_out(text: str) -> str:
    """The page without what stands between fences."""
    return re.sub(r"^ *```.*?^ *```$", "", text, flags=re.M | re.S)


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", blocks_out(page.read_text()), re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in headings}


def files(*names: str) -> list[Path]:
    """Text files of folders of the project, and files by their own names."""
    found = [file for name in names for file in [ROOT / name, *(ROOT / name).rglob("*")]]
    texts = [file for file in found if file.is_file() and file.suffix in TEXT]
    return [file for file in texts if "egg-info" not in str(file)]  # what pip made of an old README


def test_the_pages_are_few_and_the_front_page_is_short():
    assert len([*DOCS.glob("*.md"), *DOCS.glob("*.ipynb")]) <= MOST_PAGES
    assert len((ROOT / "README.md").read_text().splitlines()) <= MOST_LINES


@pytest.mark.parametrize("page", LINKED, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_leads_to_a_file_and_a_heading(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_linked_from_the_front_page():
    front = (ROOT / "README.md").read_text()
    pages = [*DOCS.glob("*.md"), *DOCS.glob("*.ipynb")]
    assert [page.name for page in pages if f"(docs/{page.name}" not in front] == []


def test_every_picture_is_shown():
    shown = "".join(page.read_text() for page in PAGES)
    assert [f.name for f in (DOCS / "images").iterdir() if f"images/{f.name})" not in shown] == []


def test_every_page_that_code_names_is_there():
    named = {
        (str(file.relative_to(ROOT)), name)
        for file in files(*CODE)
        for name in re.findall(r"\bdocs/\w+\.(?:md|ipynb)\b", file.read_text())
    }
    assert len(named) > 10
    assert {(file, name) for file, name in named if not (ROOT / name).exists()} == set()


def test_every_script_and_config_that_a_page_names_is_there():
    named = {
        (page.name, name)
        for page in LINKED
        for name in re.findall(
            r"(?<![\w/])(?:scripts|configs|examples)/[\w/]+\.\w+", page.read_text()
        )
    }
    assert len(named) > 50
    assert {(page, name) for page, name in named if not (ROOT / name).exists()} == set()


def test_every_source_file_that_a_page_names_is_there():
    places = (ROOT, ROOT / "src", ROOT / "src" / "buggy_rl", ROOT / "configs")
    names = {file.name for file in files("src", "scripts", "benchmarks", "tests", "examples")}
    for page in PAGES:
        text = page.read_text()
        made = set(re.findall(r"File\s`([^`]+)`", text))  # of a reader, on the page itself
        for name in set(re.findall(r"`((?:\w+/)*\w+\.py)`", text)) - made:
            there = any((place / name).exists() for place in places)
            assert there if "/" in name else name in names, f"{page.name}: {name}"


def test_the_figures_of_the_front_page_are_those_of_the_proof():
    front, proof = (ROOT / "README.md").read_text(), (DOCS / "proof.md").read_text()
    _, _, rest = front.partition("<!-- third_targets: begin -->")
    rows = rest.partition("<!-- third_targets: end -->")[0].split("\n")[3:-1]
    assert len(rows) > 5
    assert [row for row in rows if row not in proof] == []


def test_every_config_is_named_somewhere():
    texts = {file: file.read_text() for file in [*files(*CODE), *PAGES]}
    for config in (ROOT / "configs").glob("*.yaml"):
        assert any(config.name in text for file, text in texts.items() if file != config), config


def test_the_glossary_is_short_ordered_and_of_one_sentence_a_word():
    assert 20 <= len(WORDS) <= MOST_WORDS
    assert [word for word, _, _ in WORDS] == sorted(word for word, _, _ in WORDS)
    for word, meaning, _ in WORDS:
        sentences = re.findall(r"[.!?](?= |$)", re.sub(r"`[^`]*`", "", meaning))
        assert sentences == ["."], word
        assert meaning[0].isupper(), word


@pytest.mark.parametrize("word", [word for word, _, _ in WORDS])
def test_a_word_of_the_glossary_is_used(word):
    pages = [without_code(page.read_text()) for page in PAGES if page.name != "GLOSSARY.md"]
    source = [file.read_text() for file in (ROOT / "src").rglob("*.py")]
    prose = "".join(pages + source)
    assert len(re.findall(rf"\b{word.removesuffix('s')}", prose, re.I)) >= 3


def test_no_page_uses_a_word_that_the_glossary_replaces():
    refused = [word.strip() for _, _, row in WORDS for word in row.split(",") if word.strip()]
    assert "stretch" in refused
    for page in [*DOCS.glob("*.md"), ROOT / "README.md", ROOT / "CHANGELOG.md"]:
        prose = without_code(page.read_text())
        for word in refused:
            assert not re.search(rf"\b{word}(e?s)?\b", prose, re.I), f"{page.name}: {word}"
