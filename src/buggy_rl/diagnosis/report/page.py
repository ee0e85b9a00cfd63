"""The whole page as one file that needs no other."""

import matplotlib

from buggy_rl.diagnosis.answer import Answer
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.report import causes, sections
from buggy_rl.diagnosis.report.markup import Markup, joined, tag
from buggy_rl.diagnosis.report.style import PAGE, SETTINGS
from buggy_rl.diagnosis.search import Found, Search


def report(case: Case, search: Search, found: Found, answer: Answer) -> str:
    """The page for whoever drives the car: readable on a phone, printed, and without a network.

    Args:
        case: What was compared.
        search: That looked for causes.
        found: What it came to.
        answer: What is said.

    Returns:
        HTML.
    """
    with matplotlib.rc_context(SETTINGS):
        parts = [
            sections.verdict(answer),
            sections.driven(case, found),
            sections.located(case, answer),
            causes.candidates(search, found),
            causes.named(case.as_given, answer.effects, case.retuned_from is not None),
            causes.excluded(search, found, answer.effects),
            sections.remains(answer),
            sections.proven(answer),
            sections.following(answer),
            sections.made(case, search, found, answer),
        ]
    head = joined(
        (
            Markup('<meta charset="utf-8">'),
            Markup('<meta name="viewport" content="width=device-width, initial-scale=1">'),
            tag("title", f"Diagnosis: {', '.join(case.names)}"),
            tag("style", Markup(PAGE)),
        )
    )
    body = tag("body", tag("main", *parts))
    return f'<!doctype html>\n<html lang="en">{tag("head", head)}{body}</html>\n'
