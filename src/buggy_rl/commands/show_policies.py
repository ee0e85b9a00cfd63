r"""Draws policies on lap, infinity and the tight path, in their simulators and on the car.

    python scripts/show_policies.py policies.learned=runs/policies/learned_0/best.pt \
        policies.mujoco=runs/policies/mujoco_0/best.pt output=runs/policies.png

Trajectories are coloured by speed; that of pure pursuit is thin and grey. Prints the waypoints
closed and the mean distance from the path of both.
"""

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Runs the policies and draws their trajectories."""
    config = from_command_line(__doc__, "buggy_rl.policies.evaluation.drives:ShowPoliciesConfig")

    import torch

    from buggy_rl.figures.policies import policies_figure
    from buggy_rl.figures.style import save_figure
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.policies.evaluation.drives import policy_panels

    torch.set_num_threads(config.threads)
    found = list(policy_panels(config, lambda todo: tqdm(todo, "driving", unit="place")))
    print(f"{'policy':16} {'driven':22} {'path':9} {'waypoints':>9} {'off path':>9}  pure pursuit")
    for p in found:
        own, other = (f"{t.waypoints:9.0f} {t.lateral_mean:7.3f} m" for t in (p.track, p.compared))
        print(f"{p.policy:16} {p.place:22} {p.course:9} {own}  {other.strip()}")
    save_figure(policies_figure(found), config.output)


if __name__ == "__main__":
    run(main)
