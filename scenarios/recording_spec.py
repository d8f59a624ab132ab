"""The file of a recording: where its images are, the front end and the estimators."""

from __future__ import annotations

import functools
from typing import Annotated, Any, Literal

from pydantic import Field, create_model, model_validator

from estimators.stereo.features import FrontEnd
from scenarios import spec
from sim.recording import Recorded
from sim.scenario import Spec

# What suits a whole scene, and a vehicle that is small in the image.
_SUITS: dict[str, dict[str, Any]] = {
    "background": {"points": 800, "distance_px": 6.0, "patch_px": 11},
    "box": {"points": 80, "distance_px": 3.0, "patch_px": 9},
}


class RecordingFrontEnd(Spec):
    """The image front end by its constructor's arguments; by default what suits the target."""

    @model_validator(mode="after")
    def _constructible(self) -> RecordingFrontEnd:
        self.build_for("background")
        return self

    def build_for(self, target: str) -> FrontEnd:
        """The front end for a target; raises ValueError where its constructor does."""
        given = {name: value for name, value in self if value is not None}
        return FrontEnd(**(_SUITS[target] | given))


class RecordingSpec(Spec):
    """A recording without its estimators."""

    title: str
    source: str = ""
    kind: Literal["recording"]
    recording: Recorded

    @property
    def seed(self) -> int:
        """Nothing is drawn; the number only names the folder."""
        return 1


@functools.cache
def recording_model() -> type[RecordingSpec]:
    """The model of a recording's file with the estimators that are installed."""
    arguments = spec.constructor(FrontEnd)
    fields: dict[str, Any] = {n: (hint | None, None) for n, (hint, _) in arguments.items() if n != "segmentation"}
    chosen = create_model("front_end", __base__=RecordingFrontEnd, __doc__=FrontEnd.__doc__, **fields)
    one = spec.estimator_type()

    class Run(RecordingSpec):
        """A recording's file: images, image front end and estimators."""

        front_end: chosen = Field(default_factory=chosen)  # type: ignore[valid-type]  # made above
        estimator: Annotated[tuple[one, ...], Field(min_length=1)]  # type: ignore[valid-type]  # made above

        @model_validator(mode="after")
        def _unique_labels(self) -> Run:
            spec.check_labels(self.estimator)
            return self

        @property
        def without_estimators(self) -> RecordingSpec:
            return self.model_copy(update={"estimator": ()})

    Run.__name__ = "Recording"
    return Run
