"""YAML files and dotted overrides on the command line -> a typed, frozen dataclass.

`python scripts/train_models.py configs/sample.yaml training.epochs=3`: the dataclass holds the
defaults, YAML only what differs; what comes later wins, and unknown keys are refused. A file is one
layer, and so are overrides that follow one another, in any order among themselves. Options that
belong to a name (`belongs_to`) go when a later layer gives another name. What a text
on the command line means follows from the option's type (`option_values`): brackets about a list
may be left out.
"""

import dataclasses
import importlib
import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf, read_write
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException

from buggy_rl.core import trust
from buggy_rl.core.files import write_atomically, write_json
from buggy_rl.core.option_values import (
    describe,
    is_list,
    is_text,
    list_of,
    nearest,
    option_names,
    option_type,
    text_of,
)

CONFIGS = Path(__file__).parents[1] / "configs"  # those that the package ships
OWNER = "owner"  # key of a field's metadata
OPTIONS = "Options, as key=value, lists as key=one,two (or in a YAML file):"


def from_command_line(doc: str | None, schema: str, argv: Sequence[str] | None = None) -> Any:
    """Builds the config that a command line describes, or prints help and exits.

    Args:
        doc: The script's docstring, printed by `--help`.
        schema: `package.module:Class` of a frozen dataclass.
        argv: YAML files and `dotted.key=value` overrides; those of the process by default.

    Raises:
        SystemExit: After `--help`, or with one line about what is wrong with the arguments.
    """
    argv = trust.taken(sys.argv[1:] if argv is None else argv)
    if any(argument in ("-h", "--help") for argument in argv):
        print(f"{(doc or '').strip()}\n\n{OPTIONS}\n")
        print("\n".join(describe(schema)))
        print(trust.HELP)
        raise SystemExit(0)
    module, _, name = schema.partition(":")
    try:
        return build(getattr(importlib.import_module(module), name), argv)
    except ConfigError as error:
        raise SystemExit(f"error: {error} (--help lists every option)") from None


class ConfigError(ValueError):
    """The configuration is wrong; the message says where and what would be right."""


def belongs_to(owner: str) -> dict[str, str]:
    """Metadata of a field whose content makes sense for one value of the field `owner` only.

    A config layer that changes the owner empties the field, then merges its own content into it.
    """
    return {OWNER: owner}


def build(cls: type, arguments: Sequence[str]) -> Any:
    """Merges YAML files and `dotted.key=value` overrides, in order, over the class's defaults.

    Raises:
        ConfigError: An argument cannot be read, names an unknown key, or a needed value is missing.
    """
    config = OmegaConf.structured(cls)
    for overrides, group in groupby(arguments, lambda argument: "=" in argument):
        read = partial(_override, cls) if overrides else _read_yaml
        layers = [(argument, read(argument)) for argument in group]
        for part in [layers] if overrides else [[layer] for layer in layers]:
            config = _merge(config, part)
    _refuse_missing(config)
    return OmegaConf.to_object(config)


def from_python(
    cls: type, given: Mapping[str, Any], source: str, files: Sequence[str | Path] = ()
) -> Any:
    """Merges YAML files, then settings given in Python, over the class's defaults.

    Args:
        cls: Of the config.
        given: By name, dotted (`{"ppo.steps": 1000}`) or nested (`{"ppo": {"steps": 1000}}`).
        source: Of `given`, for messages.
        files: In order; of the package's own configs a name such as `configs/ppo.yaml`.

    Raises:
        ConfigError: As `build`.
    """
    config = OmegaConf.structured(cls)
    for file in files:
        config = _merge(config, [(str(file), _read_yaml(str(file)))])
    parts = [(source, _nested(key, _of_python(value))) for key, value in given.items()]
    config = _merge(config, parts)
    _refuse_missing(config, f"{source}: ")
    return OmegaConf.to_object(config)


def _of_python(value: Any) -> Any:
    """A value as YAML would hold it: paths are texts, tuples lists."""
    if isinstance(value, Mapping):
        return {key: _of_python(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_of_python(inner) for inner in value]
    return str(value) if isinstance(value, Path) else value


def from_plain(cls: type, content: Mapping[str, Any], source: str) -> Any:
    """Builds a config from what `plain_values` made of one, such as that in a policy file.

    Raises:
        ConfigError: It has a key or value that the class does not take; the message names `source`.
    """
    layer = OmegaConf.create(dict(content))
    _refuse_missing(layer, f"{source}: ")  # `???`, which a merge would leave at the default
    config = _merge(OmegaConf.structured(cls), [(source, layer)])
    _refuse_missing(config, f"{source}: ")
    return OmegaConf.to_object(config)


def _refuse_missing(config: Any, source: str = "") -> None:
    missing = OmegaConf.missing_keys(config)
    if missing:
        raise ConfigError(f"{source}needed but not given: {', '.join(sorted(missing))}")


def _read_yaml(argument: str):
    file = config_file(argument)
    if not file.is_file():
        raise ConfigError(f"there is no config file {file} (options are written key=value)")
    try:
        return OmegaConf.load(file)
    except yaml.YAMLError as error:
        raise ConfigError(f"{file} is not YAML: {' '.join(str(error).split())}") from None


def config_file(name: str | Path) -> Path:
    """The file of a name: one that is there, else that of the package's own configs.

    Args:
        name: A path; of the package's own with or without `configs/` before it.
    """
    file = Path(name)
    if file.exists() or file.is_absolute():
        return file
    own = CONFIGS.joinpath(*file.parts[file.parts[0] == CONFIGS.name :]) if file.parts else file
    return own if own.is_file() else file


def _override(cls: type, argument: str):
    key, _, text = argument.partition("=")
    kind = option_type(cls, key)
    try:
        if is_list(kind):
            return _nested(key, list_of(kind, text))
        if is_text(kind):
            return _nested(key, text_of(kind, text))
        return OmegaConf.from_dotlist([argument])
    except ValueError as error:
        raise ConfigError(f"{key}: {error}") from None
    except Exception as error:
        message = " ".join(str(error).split())
        raise ConfigError(f"{argument!r} is not key=value: {message}") from None


def _nested(key: str, value: Any) -> DictConfig:
    """A config with one value, under a dotted key."""
    for part in reversed(key.split(".")):
        value = {part: value}
    return OmegaConf.create(value)


def _listed(cls: Any, part: Any, source: str, key: str = "") -> Any:
    """Plain content of a layer, with single values in lists where the class has lists."""
    listed = bool(key) and is_list(option_type(cls, key))
    if isinstance(part, Mapping):
        if listed:
            raise ConfigError(f"{source}: {key}: a list is expected: write [one, two]")
        inner = f"{key}." if key else ""
        return {name: _listed(cls, value, source, f"{inner}{name}") for name, value in part.items()}
    single = not isinstance(part, list | tuple) and part is not None and str(part)[:2] != "${"
    return [part] if listed and single else part


def _merge(config, layers):
    """Merges the parts of one layer, each with its source, into a config."""
    cls: Any = OmegaConf.get_type(config)
    layers = [
        (source, OmegaConf.create(_listed(cls, OmegaConf.to_container(part), source)))
        for source, part in layers
    ]
    _empty_options(config, [OmegaConf.to_container(part) for _, part in layers])
    for source, part in layers:
        with _naming(source, cls):
            config = OmegaConf.merge(config, part)
    return config


def _empty_options(config, parts) -> None:
    """Empties the fields whose owner (`belongs_to`) the parts of a layer change."""
    parts = [part for part in parts if isinstance(part, dict)]
    if not isinstance(config, DictConfig) or not parts:
        return
    given = {key: value for part in parts for key, value in part.items()}  # the last one wins
    kind: Any = OmegaConf.get_type(config)
    here: Any = OmegaConf.to_container(config)
    for field in dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ():
        owner = field.metadata.get(OWNER)
        if owner in given and given[owner] != here[owner]:
            with read_write(config):
                config[field.name] = {}
    for key in given:
        if key in config:
            _empty_options(config[key], [part.get(key) for part in parts])


@contextmanager
def _naming(source: str, cls: type) -> Iterator[None]:
    """Turns what OmegaConf raises into one line that names the source."""
    try:
        yield
    except ConfigKeyError as error:
        raise ConfigError(f"{source}: {_unknown_key(error, cls)}") from None
    except (OmegaConfBaseException, TypeError, AttributeError) as error:
        what = str(error).splitlines()[0]
        place = getattr(error, "full_key", None)
        where = f"{source}: {place}" if place else source
        raise ConfigError(f"{where}: {what}") from None


def _unknown_key(error, cls: type) -> str:
    key = str(error.full_key or error.key)
    fields = dataclasses.fields(error.object_type) if error.object_type else ()
    known, own = sorted(field.name for field in fields), key.rpartition(".")[2]
    elsewhere = [name for name in option_names(cls) if name.rpartition(".")[2] == own]
    hint = nearest(own, known) or (f"did you mean {elsewhere[0]!r}? " if elsewhere else "")
    return f"unknown key {key!r}; {hint}available: {', '.join(known)}"


def one_line(error: Exception) -> str:
    """The first line of an error's message, of a KeyError too without quotes around it."""
    message = error.args[0] if isinstance(error, KeyError) and error.args else error
    return (str(message).splitlines() or [type(error).__name__])[0]


def load_named(name: str) -> Any:
    """What is named by `path/to/file.py:attribute` or `package.module:attribute`.

    Raises:
        ValueError: There is no such file, module or attribute.
    """
    place, _, attribute = name.rpartition(":")
    if place.endswith(".py"):
        if not Path(place).is_file():
            raise ValueError(f"{name}: there is no file {place}")
        spec = importlib.util.spec_from_file_location(Path(place).stem, place)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    else:
        module = _module(name, place)
    if not hasattr(module, attribute):
        raise ValueError(f"{name}: {place} has no {attribute!r}")
    return getattr(module, attribute)


def _module(name: str, place: str) -> Any:
    try:
        return importlib.import_module(place)
    except ModuleNotFoundError as error:
        if error.name and (place == error.name or place.startswith(f"{error.name}.")):
            raise ValueError(f"{name}: there is no module {error.name}") from None
        raise  # one that it imports is missing


def run(main: Callable[[], None]) -> None:
    """Runs a script's main so that what a user can mend is one line, not a traceback.

    Killed by SIGTERM it ends as by Ctrl-C, so that what it has started ends with it. Set
    BUGGY_RL_TRACEBACK=1 to see where an error comes from all the same.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main()
    except (ValueError, KeyError, OSError, FloatingPointError) as error:
        if os.environ.get("BUGGY_RL_TRACEBACK"):
            raise
        message = error.args[0] if isinstance(error, KeyError) and error.args else error
        raise SystemExit(f"error: {message}") from None


def save_run(config: Any, folder: Path, of: str = "") -> None:
    """Writes what a run needs to be made again: resolved config, command, commit.

    Written together with the result, so that a run which is refused or killed leaves the config of
    the result that is there.

    Args:
        config: The run's.
        folder: Of the result.
        of: Name of the result, where others with a config of their own lie in the folder.
    """
    begin = f"{of}." if of else ""
    write_atomically(
        folder / f"{begin}config.yaml", yaml.safe_dump(plain_values(config), sort_keys=False)
    )
    write_json(folder / f"{begin}run.json", made_by())


def made_by() -> dict[str, str]:
    """Command and commit of this process."""
    return {"command": " ".join(sys.argv), "commit": _commit()}


def plain_values(config: Any) -> dict[str, Any]:
    """A dataclass as nested dictionaries of plain values that YAML and torch.save can hold."""
    return dataclasses.asdict(config)


def _commit() -> str:
    try:
        command = ["git", "describe", "--always", "--dirty"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"  # not run from a checkout
