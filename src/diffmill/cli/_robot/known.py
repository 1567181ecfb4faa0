"""Robots that need no file of one's own, and arms whose models are public."""

from importlib import resources

from ..._toml import parse_toml
from ...robot import built_in_models, drive_classes


def known_lines() -> list[str]:
    """Built-in models, arms of public URDFs and classes of drives, line by line."""
    folder = resources.files("diffmill.robot")
    lines = ["built in:"]
    for name in built_in_models():
        file = folder.joinpath("models", f"{name}.toml")
        about = str(parse_toml(file.read_bytes())["description"])
        lines.append(f"  {name:18}{about}")
    arms = parse_toml(folder.joinpath("public_arms.toml").read_bytes())
    lines += ["", "public models, to be fetched there; a xacro is expanded first:"]
    for name, arm in arms.items():
        assert isinstance(arm, dict)
        masses = f"masses: {arm['masses']}"
        lines += [
            f"  {name} ({arm['licence']}; {masses})",
            f"    {arm['repository']}",
            f"    {arm['path']}",
        ]
    lines += ["", "drives = of [robot], and --drives, for a robot without springs:"]
    for one in drive_classes().values():
        stiffness = ", ".join(f"{1e-6 * value:.3g}" for value in one.stiffness)
        lines += [
            f'  "{one.name}": {stiffness} MN m/rad, +- {one.spread:.0%} (assumed)',
            f"    {one.source}",
        ]
    return lines
