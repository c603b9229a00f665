"""An ONNX model computes what the policy computes, and says what it is for."""

import json

import numpy as np
import pytest

from navgym import agents

onnxruntime = pytest.importorskip("onnxruntime")


@pytest.mark.parametrize("name", ["auv", "deck"])
def test_a_shipped_policy_comes_back_from_onnx_to_1e_6(tmp_path, name):
    policy = agents.shipped(name)
    path = policy.to_onnx(tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(0)
    seen = rng.uniform(policy.low - 1.0, policy.high + 1.0, (1000, len(policy.low))).astype(
        np.float32
    )
    found = session.run(["action"], {"observation": seen})[0]
    np.testing.assert_allclose(found, policy(seen), rtol=0.0, atol=1e-6)
    assert np.ptp(found) > 0.1
    told = json.loads(session.get_modelmeta().custom_metadata_map["navgym"])
    assert told["environment"] == policy.manifest.environment
    assert told["reference"] == dict(policy.manifest.reference)
