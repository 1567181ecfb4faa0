"""The kinds of identification that a file can name."""

from . import (
    controller,
    coupled,
    force_records,
    frequency_response,
    kinematics,
    load_tests,
    mean_forces,
    reversal,
    ring_down,
)

KINDS = {
    kind.name: kind
    for kind in (
        mean_forces.KIND,
        force_records.KIND,
        load_tests.KIND,
        ring_down.KIND,
        frequency_response.KIND,
        coupled.KIND,
        controller.KIND,
        kinematics.KIND,
        reversal.KIND,
    )
}
