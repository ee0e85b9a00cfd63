"""Where the form of a repaired simulator is wrong."""

from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.answer.behaviour import FormFault, form_faults
from buggy_rl.estimation.segments import cut_segments
from tests.diagnosis.test_localisation import drives, rows_of


def faults(off):
    """Of residuals `off` [N, K, 6] of a hypothesis without effects; noise 0.01 everywhere."""
    segments = cut_segments(drives(), 1.0, 0.5)
    instants = rows_of(segments) - segments.start
    residual = off(segments).unsqueeze(0)
    simulation = SimpleNamespace(residuals=lambda *_: residual, instants=lambda _: instants)
    library = SimpleNamespace(settings=lambda _: None)
    noise = SimpleNamespace(sd=torch.full((6,), 0.01))
    problem = SimpleNamespace(
        segments=segments, simulation=simulation, library=library, noise=noise
    )
    fit = SimpleNamespace(vector=None)
    return form_faults(problem, SimpleNamespace(described=SimpleNamespace(fit=fit)))


def noise(segments):
    generator = torch.Generator().manual_seed(0)
    count = len(rows_of(segments))
    return 0.01 * torch.randn(len(segments), count, 6, generator=generator)


def test_noise_has_no_side():
    assert faults(noise) == []


def test_a_yaw_rate_that_is_too_low_to_the_left_is_found_with_its_sign_and_condition():
    def off(segments):
        residual = noise(segments)
        left = segments.action[:, rows_of(segments), 1] > 0.3
        residual[..., 5] -= 0.2 * left
        return residual

    [fault] = faults(off)
    assert (fault.channel, fault.condition) == ("yaw_rate", "steering")
    assert fault.median == pytest.approx(-0.2, abs=0.02)
    assert fault.low >= 0.2
    assert fault.line().startswith("yaw rate 0.2 rad/s too low (median) at steering 0.")


def test_a_fault_says_its_units():
    line = FormFault("vx", "vx", 1.0, 2.0, 0.1).line()
    assert line == "speed 0.1 m/s too high (median) at speed 1 to 2 m/s"
