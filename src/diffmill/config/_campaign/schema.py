"""The tables of a campaign: which keys of a job vary, and how."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, StrictBool, StrictInt, StrictStr

from ...settings.fields import Tolerance, Uncertainty
from ...settings.tables import TomlTable

Key: TypeAlias = Annotated[StrictStr, Field(min_length=1)]
Number: TypeAlias = Annotated[StrictInt, Field(ge=0)]
Count: TypeAlias = Annotated[StrictInt, Field(ge=1)]
Factor: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class SweepTable(TomlTable):
    """`[[sweep]]` of a campaign: a key of the job and the values that it takes.

    Either `values`, what the job may have there, or `factors` of the value that it
    holds, for a list of each entry.
    """

    key: Key = Field(description='a key of the job, such as "spindle.speed"')
    values: Annotated[list[object], Field(min_length=1)] | None = Field(
        None, description='what the job may have there, such as ["50 mm/s", "60 mm/s"]'
    )
    factors: Annotated[list[Factor], Field(min_length=1)] | None = Field(
        None, description="what the job's own value is multiplied by, such as [0.5, 1]"
    )


class DrawTable(TomlTable):
    """`[[draw]]` of a campaign: a key of the job and how its values scatter.

    Either `relative`, about the value that the job holds (each entry of a list on its
    own), or `mean` and `deviation` of a normal distribution, or `lower` and `upper` of
    a uniform one.
    """

    key: Key = Field(description='a key of the job, such as "force.K_tc"')
    kind: Literal["normal", "uniform", "lognormal"] = Field(
        default="normal", description="distribution of the values"
    )
    relative: Uncertainty | None = Field(
        default=None,
        description="scatter relative to the value of the job, such as 0.2; required "
        "without numbers of its own",
    )
    mean: StrictStr | float | None = Field(
        default=None,
        description='mean of a normal distribution, such as "1000 N/mm^2"; required '
        "without relative",
    )
    deviation: StrictStr | float | None = Field(
        default=None,
        description='standard deviation of a normal distribution, such as "50 N/mm^2"; '
        "required without relative",
    )
    lower: StrictStr | float | None = Field(
        default=None,
        description='lower end of a uniform distribution, such as "900 N/mm^2"; '
        "required without relative",
    )
    upper: StrictStr | float | None = Field(
        default=None,
        description='upper end of a uniform distribution, such as "1100 N/mm^2"; '
        "required without relative",
    )


class StartsTable(TomlTable):
    """`[starts]` of a campaign: the optimiser's starts, the first as without it."""

    count: Count = Field(description="number of starts, the first one included")
    spread: Tolerance = Field(
        description='standard deviation of random offsets at the knots, such as "20 um"'
    )


class CampaignTable(TomlTable):
    """A campaign: keys before all tables."""

    job: Key = Field(description='a job file, such as "part.toml"')
    command: Literal["simulate", "correct"] = Field(
        default="simulate", description="what is done with each job"
    )
    draws: Number = Field(
        default=0, description="how often the keys of all [[draw]] are drawn"
    )
    seed: Number = Field(default=0, description="seed of the draws")
    keep_rows: StrictBool = Field(
        default=False, description="true: keeps the whole result of each job"
    )
    sweep: list[SweepTable] = Field(
        default_factory=list, description="keys that take given values, as a grid"
    )
    draw: list[DrawTable] = Field(
        default_factory=list, description="keys whose values scatter"
    )
    starts: StartsTable | None = Field(
        default=None,
        description='starts of the optimiser with command = "correct"; that of the job '
        "alone if left out",
    )
