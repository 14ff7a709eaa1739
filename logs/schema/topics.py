"""Our own topics, and the message of each."""

from typing import Any

from logs.schema import cablequad_pb2 as pb

TOPICS: dict[str, Any] = {
    "/plant/state": pb.PlantState,
    "/control/state": pb.ControlState,
    "/control/reference": pb.ControlReference,
    "/control/estimate": pb.EstimateError,
    "/event": pb.Event,
    "/plant/event": pb.Event,
    "/plant/wind": pb.Wind,
    "/perf": pb.Perf,
}
