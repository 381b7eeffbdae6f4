"""Programs that outlive the process: `kept` is `jax.jit` whose traces are kept in a folder.

JAX keeps the machine code of programs, but traces and lowers them anew in every process, which
takes longer than all that most commands compute. What is kept here is the lowered program
(`jax.export`), under a name that holds everything it depends on: the sources of the model and of
the function, the versions of JAX and NumPyro, and the types of the arguments. JAX's own cache has
the machine code that belongs to it.

    POSETERIOR_PROGRAMS=folder               # in the environment: commands set it

    @kept                                    # where `jax.jit` would stand
    def log_joint(model, observation, ...):  # returns arrays, in tuples at most
"""

import contextlib
import functools
import hashlib
import os
import platform
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
from jax import export

OURS = ("builtins", "collections", "poseterior")
"""Packages whose classes in an argument are known by their sources' state: a class of a user's own
may change while its name stays."""
_VERSIONS = ("jax", "jaxlib", "numpyro")
_SEAL = hashlib.sha256().digest_size
VARIABLE = "POSETERIOR_PROGRAMS"
"""Of the environment: the folder in which programs are kept; none are where it is empty."""

if not os.environ.get(VARIABLE):
    # What is traced in this process needs NumPyro, and the sooner the better: it brings Pallas,
    # whose settings are part of what JAX knows a compiled function by, so that all that was
    # compiled before it would be compiled again at its next call.
    import numpyro  # noqa: F401


def kept[**P](function: Callable[P, Any]) -> Callable[P, Any]:
    """A function of pytrees, compiled by JAX; where the environment names a folder, its programs
    are kept there. Its arguments are positional, and what it returns are arrays, or tuples of
    them. Raises `TypeError` where it returns anything else, since that has no file, with a folder
    or without: tests run without one."""

    @functools.wraps(function)
    def plain(*given: P.args, **named: P.kwargs) -> Any:
        return _plain(function(*given, **named), function.__qualname__)

    compiled, ready = jax.jit(plain), dict[Any, Callable]()

    @functools.wraps(function)
    def call(*given: P.args, **named: P.kwargs) -> Any:
        leaves, tree = jax.tree.flatten(given)
        traced = any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)
        folder = os.environ.get(VARIABLE)
        if not folder or named or traced or not _known(tree):
            return compiled(*given, **named)
        kind = tree, tuple(jax.typeof(leaf) for leaf in leaves)
        if kind not in ready:
            ready[kind] = _program(function, tree, leaves, Path(folder))
        return ready[kind](*leaves)

    return call


def _program(function: Any, tree: Any, leaves: list, folder: Path) -> Callable:
    """The program of a function for such arguments: found, or traced and kept."""

    def flat(*leaves: Any) -> Any:
        return _plain(function(*jax.tree.unflatten(tree, leaves)), function.__qualname__)

    types = [(str(kind := jax.typeof(leaf)), kind.weak_type) for leaf in leaves]
    whole = f"{_state(function.__code__.co_filename)} {function.__qualname__} {tree} {types}"
    name = hashlib.sha256(whole.encode()).hexdigest()
    path = folder / f"{function.__name__}-{name[:32]}.program"
    program = _read(path)
    if program is None:
        program = export.export(jax.jit(flat))(*leaves)
        _write(path, bytes(program.serialize()))
    return jax.jit(program.call)


def _plain(found: Any, name: str) -> Any:
    """What a kept function of this name returned: leaves, and tuples that are no more than that."""
    if type(found) is tuple:
        return tuple(_plain(part, name) for part in found)
    if not jax.tree_util.treedef_is_leaf(jax.tree.structure(found)):
        raise TypeError(f"{name} returns a {type(found).__name__}, whose program cannot be kept")
    return found


def _read(path: Path) -> Any:
    """The program in a file; None where there is none, or not a whole one."""
    try:
        whole = path.read_bytes()
    except OSError:
        return None
    seal, content = whole[:_SEAL], whole[_SEAL:]
    if hashlib.sha256(content).digest() != seal:
        return None
    return export.deserialize(bytearray(content))


def _write(path: Path, content: bytes) -> None:
    """Keeps a program, whole or not at all; where that cannot be, the next process traces it
    again."""
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(hashlib.sha256(content).digest() + content)
        os.replace(partial, path)


@functools.cache
def _state(own: str) -> str:
    """All that a program depends on beside the kind of its arguments: the sources of the model and
    of the function, and what traces them, for what."""
    digest = hashlib.sha256(_model() + Path(own).read_bytes())
    versions = [metadata.version(name) for name in _VERSIONS]
    settings = jax.config.jax_default_matmul_precision, jax.default_backend()
    return f"{digest.hexdigest()} {versions} {platform.python_version()} {settings}"


@functools.cache
def _model() -> bytes:
    """The sources of the model in short: read once, since there are many of them."""
    sources = sorted(Path(__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).digest()


def _known(tree: Any) -> bool:
    """Whether all classes in the structure of some arguments are ours."""
    node = tree.node_data()
    if node is None:
        return True
    return _is_ours(node[0]) and _says_ours(node[1]) and all(map(_known, tree.children()))


def _is_ours(kind: type) -> bool:
    return kind.__module__.partition(".")[0] in OURS


def _says_ours(about: Any) -> bool:
    """Whether what a node says of itself beside its arrays is made of our classes."""
    if isinstance(about, tuple | list):
        return all(map(_says_ours, about))
    return _is_ours(about if isinstance(about, type) else type(about))
