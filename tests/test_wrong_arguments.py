"""Wrong arguments of every public name are refused by a TactiluxError that names the argument."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tactilux
from render.preview import Preview

MODEL = Path(__file__).parents[1] / "models" / "finger20"
PHI, BENDS = np.array([np.pi / 2]), np.array([0.0])
TINY = {"phi": PHI, "bends": BENDS, "samples": 1}
STRANGERS: dict[str, Callable[[SimpleNamespace], Any]] = {
    "nothing": lambda here: None,
    "a number": lambda here: 3,
    "a fraction": lambda here: 0.5,
    "below zero": lambda here: -1,
    "not a number": lambda here: float("nan"),
    "true": lambda here: True,
    "a text": lambda here: "no-such-thing",
    "an empty text": lambda here: "",
    "a text with a zero": lambda here: "a\0b",
    "bytes": lambda here: b"finger20",
    "a list": lambda here: [],
    "a list of texts": lambda here: ["red", "green"],
    "rows of two lengths": lambda here: [[0.5], [0.5, 0.5]],
    "a table": lambda here: {"thickness": 3},
    "an array": lambda here: np.zeros((2, 2, 2)),
    "an array with a hole": lambda here: np.array([0.5, np.nan]),
    "an array of texts": lambda here: np.array(["a"]),
    "a missing file": lambda here: Path("no") / "such.file",
    "a folder": lambda here: here.folder,
    "a file of something else": lambda here: (here.text.write_text("words"), here.text)[1],
    "a class": lambda here: tactilux.Scene,
    "a scene": lambda here: here.scene,
    "another scene": lambda here: here.other,
    "a design": lambda here: here.design,
    "a design of another scene": lambda here: here.other_design,
    "a model": lambda here: here.model,
    "a model of another scene": lambda here: here.other_model,
    "a table of transport": lambda here: here.table,
}
"""What somebody may give by mistake for anything."""


@dataclass(frozen=True)
class Case:
    """A public callable, arguments that are right, and strangers that an argument may be."""

    call: Callable[[SimpleNamespace], Callable[..., Any]]
    right: Callable[[SimpleNamespace], dict[str, Any]]
    may_be: dict[str, set[str]] = field(default_factory=dict)
    light: bool = True  # the right call takes no time, so that a stranger may pass


NOTHING, WHOLE = "nothing", {"a number", "a model"}
SCENE = {"a scene", "another scene"}
ANY_PATH = {"a text", "a missing file", "a folder", "a file of something else"}
CASES: dict[str, Case] = {
    "load_scene": Case(lambda h: tactilux.load_scene, lambda h: {"name_or_path": "finger20"}),
    "baseline_design": Case(
        lambda h: tactilux.baseline_design, lambda h: {"scene": h.scene}, {"scene": SCENE}
    ),
    "load_table": Case(lambda h: tactilux.load_table, lambda h: {"path": h.table_file}),
    "load_design": Case(
        lambda h: tactilux.load_design,
        lambda h: {"path": h.design_file, "scene": h.scene},
        {"scene": {"a scene"}},
    ),
    "save_design": Case(
        lambda h: tactilux.save_design,
        lambda h: {"path": h.design_file, "design": h.design, "scene": h.scene, "rating": None},
        {"path": ANY_PATH - {"a folder"}, "design": {"a design"}, "scene": {"a scene"},
         "rating": {NOTHING}},
    ),
    "save_scene": Case(
        lambda h: tactilux.save_scene,
        lambda h: {"path": h.folder.parent / "saved.toml", "scene": h.scene},
        # What a path named before is a scene by then.
        {"path": ANY_PATH - {"a folder"}, "scene": SCENE | {"a text", "a missing file"}},
    ),
    "places": Case(
        lambda h: tactilux.places,
        lambda h: {"scene": h.scene, "lamps": None, "parts": None, "shots": None},
        {"scene": SCENE, "lamps": {NOTHING, "a number"}, "parts": {NOTHING, "a list"},
         "shots": {NOTHING, "a number"}},
    ),
    "build": Case(
        lambda h: tactilux.build,
        lambda h: {"design": h.design, "scene": h.scene, "name": "mine"},
        {"design": {"a design"}, "scene": {"a scene"}, "name": {"a text"}},
    ),
    "load_model": Case(
        lambda h: tactilux.load_model,
        lambda h: {"scene": h.scene, "folder": None, "coarse": False, "progress": None},
        {"scene": SCENE, "folder": {NOTHING}, "coarse": {"true"},
         "progress": {NOTHING, "true", "a class"}},
    ),
    "rate": Case(
        lambda h: tactilux.rate,
        lambda h: {"design": h.design, "scene": h.scene, "model": h.model, "progress": None},
        {"design": {"a design"}, "scene": {"a scene"}, "model": {NOTHING, "a model"},
         "progress": {NOTHING, "true", "a class"}},
    ),
    "reconstruct": Case(
        lambda h: tactilux.reconstruct,
        lambda h: {"design": h.design, "scene": h.scene, "model": h.model, "read_noise": 1.0,
                   "full_well": 1e4, "seed": 0, "progress": None},
        {"design": {"a design"}, "scene": {"a scene"}, "model": {NOTHING, "a model"},
         "read_noise": {NOTHING, "a number", "a fraction"}, "full_well": {NOTHING, "a number"},
         "seed": {"a number"}, "progress": {NOTHING, "true", "a class"}},
        light=False,
    ),
    "picture": Case(
        lambda h: tactilux.picture,
        lambda h: {"design": h.design, "scene": h.scene, "bend": 0.0, "size": (6, 8),
                   "samples": None, "seed": 1, "progress": None},
        {"design": {"a design"}, "scene": {"a scene"}, "bend": {"a number", "a fraction"},
         "size": {NOTHING}, "samples": {NOTHING, "a number"}, "seed": {"a number"},
         "progress": {NOTHING, "true", "a class"}},
        light=False,
    ),
    "explore": Case(
        lambda h: tactilux.explore,
        lambda h: {"scene": h.scene, "model": h.model, "seed": 0, "progress": None},
        {"scene": {"a scene"}, "model": {NOTHING, "a model"}, "seed": {"a number"},
         "progress": {NOTHING, "true", "a class"}},
        light=False,
    ),
    "study": Case(
        lambda h: tactilux.study,
        lambda h: {"scene": h.scene, "vary": {"coating.albedo": [0.5]}, "coarse": True, "seed": 0,
                   "lamps_follow": False, "objective": "place", "checkpoint": None,
                   "progress": None},
        {"scene": {"a scene", "another scene"}, "coarse": {"true"}, "seed": {"a number"},
         "checkpoint": {NOTHING, "a text", "a missing file", "a folder"},
         "progress": {NOTHING, "true", "a class"}},
        light=False,
    ),
    "verify": Case(
        lambda h: tactilux.verify,
        lambda h: {"design": h.design, "scene": h.scene, "model": h.model, "samples": 1,
                   "seeds": (1,), "checkpoint": None, "progress": None},
        {"design": {"a design"}, "scene": {"a scene"}, "model": {NOTHING, "a model"},
         "samples": {"a number"}, "checkpoint": {NOTHING, "a text", "a missing file", "a folder"},
         "progress": {NOTHING, "true", "a class"}},
        light=False,
    ),
    "optimize": Case(
        lambda h: tactilux.optimize,
        lambda h: {"scene": h.scene, "model": h.model, "method": "loop", "samples": 1, "seed": 0,
                   "checkpoint": None, "progress": None},
        {"scene": {"a scene"}, "model": {NOTHING, "a model"}, "samples": {"a number"},
         "seed": {"a number"}, "checkpoint": {NOTHING, "a text", "a missing file", "a folder"},
         "progress": {NOTHING, "true", "a class"}},
        light=False,
    ),
    "render_transport": Case(
        lambda h: tactilux.render_transport,
        lambda h: {"scene": h.scene, **TINY, "seeds": (1,), "replicates": 8, "checkpoint": None,
                   "progress": None},
        {"scene": {"a scene", "another scene"}, "samples": {"a number"},
         "replicates": {"a number"},
         "checkpoint": {NOTHING, "a text", "a missing file", "a folder"},
         "progress": {NOTHING, "true", "a class"}},
        light=False,
    ),
    "Preview": Case(
        lambda h: tactilux.Preview,
        lambda h: {"scene": h.scene, "backend": None, "cache": None, "lights": None,
                   "imprint": None},
        {"scene": SCENE, "backend": {NOTHING},
         "cache": {NOTHING, "a text", "a missing file", "a folder"}, "lights": {NOTHING},
         "imprint": {NOTHING}},
        light=False,
    ),
    "Preview.transport": Case(
        lambda h: h.preview.transport, lambda h: {"phi": PHI, "bends": BENDS}
    ),
    "Preview.skin": Case(lambda h: h.preview.skin, lambda h: {"phi": PHI, "bends": BENDS}),
    "Preview.picture": Case(
        lambda h: h.preview.picture,
        lambda h: {"phi": h.design.phi, "power": h.design.power, "bend": 0.0, "width": 6,
                   "height": 8},
        {"bend": {"a number", "a fraction"}, "width": {"a number"}, "height": {"a number"}},
    ),
    "Preview.sight": Case(
        lambda h: h.preview.sight,
        lambda h: {"bend": 0.0, "width": 6, "height": 8},
        {"bend": {"a number", "a fraction"}, "width": {"a number"}, "height": {"a number"}},
    ),
    "Checker": Case(
        lambda h: tactilux.Checker, lambda h: {"session": None, "metadata": h.model.metadata},
        {"session": set(STRANGERS)},
    ),
    "Checker.load": Case(
        lambda h: tactilux.Checker.load,
        lambda h: {"path": MODEL, "scene_hash": None, "threads": None},
        {"scene_hash": {NOTHING}, "threads": {NOTHING, "a number"}},
    ),
    "Checker.for_scene": Case(
        lambda h: tactilux.Checker.for_scene,
        lambda h: {"path": MODEL, "scene": h.scene, "threads": None},
        {"scene": {"a scene"}, "threads": {NOTHING, "a number"}},
    ),
    "Checker.run": Case(
        lambda h: h.model.run,
        lambda h: {"phi": h.design.phi[None], "power": h.design.power[None], "bends": BENDS},
    ),
    "Checker.transport_table": Case(
        lambda h: h.model.transport_table, lambda h: {"phi": PHI, "bends": BENDS},
        {"bends": {NOTHING}},
    ),
    "TransportTable": Case(
        lambda h: tactilux.TransportTable,
        lambda h: dict(vars(h.table)),
        {"exposure": {"a number", "a fraction", "true"},
         "lam": {"a number", "a fraction", "true"}, "bends": {"a list"},
         "scene_hash": {"a text", "an empty text", "a text with a zero"},
         "background": {NOTHING}, "background_se": {NOTHING}, "half_difference": {NOTHING},
         "effort": {NOTHING}},
    ),
    "TransportTable.at": Case(lambda h: h.table.at, lambda h: {"phi": h.design.phi}),
    "TransportTable.at_bends": Case(lambda h: h.table.at_bends, lambda h: {"bends": BENDS}),
    "TransportTable.save": Case(
        lambda h: h.table.save, lambda h: {"path": h.table_file},
        {"path": ANY_PATH - {"a folder"}},
    ),
    "Design": Case(
        lambda h: tactilux.Design,
        lambda h: {"phi": h.design.phi, "drive": h.design.drive, "palette": h.design.palette},
    ),
    "Design.of_colors": Case(
        lambda h: tactilux.Design.of_colors,
        lambda h: {"phi": h.design.phi, "colors": [0] * 20, "palette": h.design.palette},
    ),
    "Scene": Case(lambda h: tactilux.Scene, lambda h: {"name": "x"}, {}),
    "Scene.with_": Case(lambda h: h.scene.with_, lambda h: {"pad_thickness": 4.0}, {
        "pad_thickness": {"a number"}}),
    "Scene.in_state": Case(lambda h: h.scene.in_state, lambda h: {"number": 0.0}),
}  # fmt: skip
"""Every public callable: what is right, and which strangers are right as well."""
UNTRIED = {"register_plugins"}
"""Takes no arguments."""


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimpleNamespace]:
    folder = tmp_path_factory.mktemp("arguments")
    scene, other = tactilux.load_scene("finger20"), tactilux.load_scene("digit")
    design, model = tactilux.baseline_design(scene), tactilux.load_model(scene)
    table = model.transport_table(np.array([0.5, 2.0]), BENDS)
    (folder / "text.txt").write_text("words")
    (folder / "empty").mkdir()
    tactilux.save_design(folder / "design.json", design, scene)
    table.save(folder / "table.npz")
    with Preview(scene) as preview:
        yield SimpleNamespace(
            scene=scene, other=other, design=design, model=model, table=table, preview=preview,
            other_design=tactilux.baseline_design(other), other_model=tactilux.load_model(other),
            text=folder / "text.txt", folder=folder / "empty",
            design_file=folder / "design.json", table_file=folder / "table.npz",
        )  # fmt: skip


def test_every_public_name_is_tried() -> None:
    callables = {name for name in tactilux.__all__ if not name.endswith("Error")}
    assert callables == {name for name in CASES if "." not in name} | UNTRIED


@pytest.mark.parametrize("name", CASES)
def test_an_argument_of_a_wrong_kind_is_refused_by_name(
    name: str, here: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    case = CASES[name]
    call, right, wrong = case.call(here), case.right(here), []
    for argument in right:
        for stranger, make in STRANGERS.items():
            allowed = stranger in case.may_be.get(argument, set())
            if allowed and not case.light:
                continue
            try:
                call(**{**right, argument: make(here)})
            except tactilux.TactiluxError as error:
                said = f"{error} {error.field}"
                if allowed or "\n" in str(error) or not _named(argument, said):
                    wrong.append(f"{argument} = {stranger}: {error}")
            except Exception as error:
                wrong.append(f"{argument} = {stranger}: {type(error).__name__}: {error}")
            else:
                if not allowed:
                    wrong.append(f"{argument} = {stranger}: taken")
    assert not wrong, "\n".join(wrong)


SAID_AS = {
    "drive": "power", "design": "fiber", "name_or_path": "scene", "number": "state",
    "bends": "bend", "model": "scene_hash", "session": "metadata", "pad_thickness": "pad.thickness",
    "se": "T", "colors": "power", "folder": "checker.onnx", "path": "",
}  # fmt: skip
"""Other words for an argument, which say as well what is meant; a file's path is its own name."""


def _named(argument: str, said: str) -> bool:
    return argument in said or SAID_AS.get(argument, argument) in said


def test_arguments_in_the_wrong_order_are_refused(here: SimpleNamespace) -> None:
    for call in (
        lambda: tactilux.save_design(here.design, "x.json", here.scene),
        lambda: tactilux.save_design("x.json", here.scene, here.design),
        lambda: tactilux.load_design(here.scene, here.design_file),
        lambda: tactilux.verify(here.scene, here.design),
        lambda: tactilux.rate(here.scene, here.design),
        lambda: tactilux.explore(here.design),
        lambda: tactilux.load_model(here.folder, here.scene),
        lambda: tactilux.Design.of_colors([0] * 20, here.design.phi + 0.5),
        lambda: tactilux.render_transport(BENDS, PHI, here.scene, samples=1),
    ):
        with pytest.raises(tactilux.TactiluxError, match=r"allowed|cannot be read"):
            call()


def test_signatures_say_that_a_name_or_a_path_will_do() -> None:
    for name in CASES:
        found: Any = tactilux
        for part in name.split("."):
            found = getattr(found, part)
        parameters = inspect.signature(found).parameters
        if "scene" in parameters:
            assert parameters["scene"].annotation == "Scene | str | Path", name


def test_a_name_a_path_and_a_scene_are_the_same_scene(here: SimpleNamespace) -> None:
    file = here.folder.parent / "mini.toml"
    from render.scene import scene_text

    file.write_text(scene_text("finger20"))
    for scene in ("finger20", file, str(file), here.scene):
        assert tactilux.load_model(scene).scene_hash == here.scene.hash
        assert tactilux.baseline_design(scene).colors.tolist() == here.design.colors.tolist()
        loaded = tactilux.load_design(here.design_file, scene)
        assert loaded.phi.tolist() == here.design.phi.tolist()
    for design in (here.design_file, str(here.design_file)):
        rated = tactilux.rate(design, file, model=MODEL)
        assert rated.rating.score == pytest.approx(234.0, abs=1.0)


OPTION = re.compile(r"(?<![\w-])--[a-z]")
OF_COMMANDS = {"cli", "ui", "overnight", "frontier", "new_scene.py", "vary_command.py"}
"""Rooms and modules that commands alone use."""


def messages_with_options(path: Path) -> Iterator[int]:
    """Yield the lines of errors that name an option, other than by their ``option``."""
    for raised in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(raised, ast.Raise):
            continue
        own = {node for part in ast.walk(raised)
               if isinstance(part, ast.keyword) and part.arg == "option"
               for node in ast.walk(part)}  # fmt: skip
        words = [node.value for node in ast.walk(raised)
                 if isinstance(node, ast.Constant) and node not in own]  # fmt: skip
        message = " ".join(word for word in words if isinstance(word, str))
        if OPTION.search(message) and "tactilux " not in message:  # whole commands are for all
            yield raised.lineno


def test_no_error_of_python_names_an_option_of_the_command_line() -> None:
    root = Path(tactilux.__file__).parent
    files = [file for name in ("render", "surrogate", "optimize") for file in
             (root / name).rglob("*.py") if not OF_COMMANDS & set(file.parts)]  # fmt: skip
    told = [f"{file}:{line}" for file in files for line in messages_with_options(file)]
    assert not told
