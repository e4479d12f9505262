"""What can go wrong with the engine."""


class EngineError(RuntimeError):
    """The engine could not be started, or did something that it must not."""


class EngineLostError(EngineError):
    """A running engine died; a new one can take its place."""
