"""Fields of a pipeline and of its settings, for type checkers: ``_fields.pyi`` of a wheel lists them."""


class PipelineFields:
    """Base of ``Pipeline``; the fields themselves are read by name."""

    __slots__ = ()
