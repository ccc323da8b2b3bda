"""Import contract: a package is imported through its public names only."""

import ast
from importlib.util import find_spec
from pathlib import Path

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output


class PublicNamesContract(Contract):
    """What a package offers stands in its `__init__`, or in a module that `public_modules` names.

    A named module is public with all that is in it: it needs an extra or is heavy, so its package does not load it.
    """

    type_name = "public-names"

    root = fields.StringField()
    public_modules = fields.ListField(subfield=fields.StringField())

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:  # noqa: ARG002  the base class's signature
        packages = {name: name.split(".")[1] for name in graph.modules if name.startswith(f"{self.root}.")}
        public = {f"{self.root}.{package}" for package in packages.values()} | set(self.public_modules)
        # a function that has its module's name looks like an import of the module
        public |= {name for package in public & graph.modules for name in offered(package)}
        past = [
            f"{importer} -> {imported}"
            for importer, package in sorted(packages.items())
            for imported in sorted(graph.find_modules_directly_imported_by(importer))
            if packages.get(imported, package) != package and not self._open(imported, public)
        ]
        unused = [name for name in self.public_modules if not self._used(graph, name)]
        return ContractCheck(kept=not past and not unused, metadata={"past": past, "unused": unused})

    def render_broken_contract(self, check: ContractCheck) -> None:
        for line in check.metadata["past"]:
            output.print_error(f"past the public names: {line}")
        for name in check.metadata["unused"]:
            output.print_error(f"named as public, and imported by no other package: {name}")

    def _open(self, imported: str, public: set[str]) -> bool:
        return imported in public or any(imported.startswith(f"{name}.") for name in self.public_modules)

    def _used(self, graph: ImportGraph, name: str) -> bool:
        package = ".".join(name.split(".")[:2])
        modules = {name, *graph.find_descendants(name)} if name in graph.modules else set()
        importers = {each for module in modules for each in graph.find_modules_that_directly_import(module)}
        return any(not each.startswith(f"{package}.") and each != package for each in importers)


def offered(package: str) -> set[str]:
    """Full names of what a package lists in its `__all__`."""
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations or spec.origin is None:
        return set()
    body = ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body
    lists = [each.value for each in body if isinstance(each, ast.Assign) and ast.unparse(each.targets[0]) == "__all__"]
    return {f"{package}.{name}" for each in lists for name in ast.literal_eval(each)}
