"""A policy as an ONNX model, for whoever runs networks in C++ or on another chip.

The graph does what `Policy.__call__` does: it normalises and clips in double precision, then runs the
layers in single. What the actions mean stands in the model's metadata, as the manifest's JSON.
"""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from navgym.core.atomic import replacing

if TYPE_CHECKING:
    from navgym.agents.policies.policy import Policy

OPSET = 17  # of 2022: read by every runtime that is still kept
IR_VERSION = 8  # that goes with it


def write_onnx(policy: Policy, path: str | os.PathLike[str]) -> Path:
    """Write `policy` as an ONNX model: "observation" (N, n) float32 to "action" (N, k) float32.

    Raises RuntimeError, with the remedy, where onnx is missing.
    """
    with replacing(Path(path)) as file:
        file.write(_model(policy).SerializeToString())
    return Path(path)


def _model(policy: Policy) -> Any:
    try:
        import onnx
    except ImportError as error:
        raise RuntimeError("an ONNX model needs onnx: pip install 'navgym[onnx]'.") from error
    helper, n, k = onnx.helper, len(policy.low), len(policy.layers[-1][1])
    nodes, constants = _graph(policy)
    single = onnx.TensorProto.FLOAT
    read = helper.make_tensor_value_info("observation", single, ["N", n])
    written = helper.make_tensor_value_info("action", single, ["N", k])
    graph = helper.make_graph(
        [helper.make_node(op, inputs, [out], **more) for op, inputs, out, more in nodes],
        "navgym policy", [read], [written],
        [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()],
    )  # fmt: skip
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="navgym"
    )
    model.ir_version = IR_VERSION
    manifest = json.dumps(dataclasses.asdict(policy.manifest), ensure_ascii=False)
    helper.set_model_props(model, {"navgym": manifest})
    onnx.checker.check_model(model)
    return model


def _graph(
    policy: Policy,
) -> tuple[list[tuple[str, list[str], str, dict[str, Any]]], dict[str, Any]]:
    """Nodes (operator, inputs, output, attributes) and constants by name."""
    given = policy.normalisation
    clip = np.array(given.clip)
    constants: dict[str, Any] = {
        "mean": given.mean, "scale": np.sqrt(given.variance + given.epsilon), "low": -clip, "high": clip,
        "least": np.float32(-1), "most": np.float32(1), "reach": np.float32(policy.reach),
    }  # fmt: skip
    nodes: list[tuple[str, list[str], str, dict[str, Any]]] = [
        ("Cast", ["observation"], "double", {"to": 11}),  # TensorProto.DOUBLE
        ("Sub", ["double", "mean"], "centred", {}),
        ("Div", ["centred", "scale"], "scaled", {}),
        ("Clip", ["scaled", "low", "high"], "clipped", {}),
        ("Cast", ["clipped"], "x0", {"to": 1}),  # TensorProto.FLOAT
    ]
    activation = {"tanh": "Tanh", "relu": "Relu"}[policy.activation]
    last = len(policy.layers) - 1
    for i, (weights, bias) in enumerate(policy.layers):
        constants |= {f"w{i}": np.float32(weights), f"b{i}": np.float32(bias)}
        nodes.append(("Gemm", [f"x{i}", f"w{i}", f"b{i}"], f"y{i}", {"transB": 1}))
        if i < last:
            nodes.append((activation, [f"y{i}"], f"x{i + 1}", {}))
    out = f"y{last}"
    if policy.squash:
        nodes.append(("Tanh", [out], "squashed", {}))
        out = "squashed"
    nodes.append(("Clip", [out, "least", "most"], "bounded", {}))
    nodes.append(("Mul", ["bounded", "reach"], "action", {}))
    return nodes, {name: np.asarray(value) for name, value in constants.items()}
