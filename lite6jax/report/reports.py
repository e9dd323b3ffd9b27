"""Which domains have a report of their own; poses and torques share that of `sections`."""

from collections.abc import Mapping
from typing import Any, Protocol

from lite6jax.diagnosis.document import domain_of
from lite6jax.report import tracking


class DomainReport(Protocol):
    """The report of a domain, of its JSON document."""

    def with_statements(self, document: Mapping[str, Any]) -> dict[str, Any]:
        """The document with a `statement` for each finding and each data fault."""
        ...

    def parts_of(
        self, document: Mapping[str, Any], files: Any, details: bool, pictures: Mapping[str, Any]
    ) -> list[tuple[str, list[tuple[str, Any]]]]:
        """Headings and blocks, as of `sections`; of a document with statements; arguments as of `sections_of`."""
        ...


REPORTS: dict[str, DomainReport] = {tracking.DOMAIN: tracking}
"""By the name of the domain."""


def own_report(document: Any) -> DomainReport | None:
    """That of the document's domain; None where it shares that of poses and torques."""
    return REPORTS.get(domain_of(document))
