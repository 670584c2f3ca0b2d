"""Model of the section ``calibration``: which global factors are identified, and from which job."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from lrbc_cli.config.fields import Name, NameMap, OperatorRef, Strict, check_unique, problem

FIELDS = ("structure", "acoustic")

#: Properties of a field that a factor can scale.
SCALES = ("stiffness", "mass", "alpha", "beta", "damping", "loss_factor")

SOUND_SPEED = "sound_speed"

#: Names of all factors except those of groups.
FACTOR_NAMES = (*(f"{scale}.{field}" for field in FIELDS for scale in SCALES), SOUND_SPEED)


class FactorGroup(Strict):
    """A share of the model with its own factor: matrices that the matrices of the model contain once."""

    stiffness: OperatorRef | None = Field(default=None, description="Its share of K, given like `model.stiffness`.")
    damping: OperatorRef | None = Field(default=None, description="Its share of C, if the damping of the model is a matrix.")
    mass: OperatorRef | None = Field(default=None, description="Its share of M.")

    @property
    def matrices(self) -> dict[str, OperatorRef]:
        """The matrices that are given, by operator."""
        given = {"stiffness": self.stiffness, "damping": self.damping, "mass": self.mass}
        return {operator: ref for operator, ref in given.items() if ref is not None}

    @model_validator(mode="after")
    def _not_empty(self) -> FactorGroup:
        if not self.matrices:
            raise problem("a group without a matrix", expected="stiffness:, damping: or mass:", found="none of these keys")
        return self


class CalibrationConfig(Strict):
    """Global factors of the reference model, identified by `lrbc calibrate` from one job before boundaries are updated."""

    job: Name = Field(description="The job from which they are identified, usually the reference job (all bolts tight).")
    factors: Annotated[tuple[str, ...], AfterValidator(check_unique)] = Field(
        default=(),
        description="Factors to identify: stiffness, mass, alpha and beta (proportional damping) or damping (a damping matrix), "
        "loss_factor (what makes the stiffness complex), each with .structure or .acoustic, and sound_speed. 1 is the model as exported. "
        "The factor of every group is identified, too.",
    )
    groups: NameMap[FactorGroup] = Field(
        default={},
        validate_default=True,
        description="Further groups by name: {stiffness:, damping:, mass:}, matrices that the matrices of the model contain once.",
    )
    boundary: Literal["identify", "held"] = Field(
        default="identify",
        description="identify: the boundary parameters are identified together with the factors. held: they stay at their start values.",
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all factors to identify, groups last."""
        return (*(name for name in self.factors if name not in self.groups), *self.groups)

    @model_validator(mode="after")
    def _something(self) -> CalibrationConfig:
        for name in self.groups:
            if name in FACTOR_NAMES:
                raise problem("the group has the name of a factor", "groups", name, hint="choose another name")
        if not self.names:
            raise problem("a calibration without factors", "factors", expected="at least one factor or group")
        if SOUND_SPEED in self.factors and "stiffness.acoustic" in self.factors:
            raise problem(
                "two factors for the same effect",
                "factors",
                self.factors.index(SOUND_SPEED),
                expected="sound_speed or stiffness.acoustic",
                found="both: sound_speed² scales the acoustic stiffness 1/rho, too",
                hint="remove one of them",
            )
        return self
