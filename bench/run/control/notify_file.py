"""The user's own wishes about notifications, for stations that say nothing about them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.model.yamlio import load_yaml
from bench.plan.notify_language import Notify


def user_notify(environment: Mapping[str, str]) -> Notify | None:
    """What ``inertial-bench/notify.yaml`` in the user's configuration folder says; None if there is no such file.

    Raises: InputErrors with every mistake and its position.
    Source: XDG Base Directory Specification: XDG_CONFIG_HOME, else ~/.config.
    """
    base = environment.get("XDG_CONFIG_HOME", "")
    folder = Path(base) if Path(base).is_absolute() else Path(environment.get("HOME", "/")) / ".config"
    path = folder / "inertial-bench" / "notify.yaml"
    return load_yaml(path, Notify).model if path.is_file() else None
