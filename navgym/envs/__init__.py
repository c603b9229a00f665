"""Gymnasium environments; importing `navgym` registers them."""

from __future__ import annotations

AUV_DROPOUT = "navgym/AUVDropout-v0"


def register_all() -> None:
    """Register every environment of navgym with Gymnasium; doing it twice changes nothing."""
    import gymnasium

    if AUV_DROPOUT not in gymnasium.registry:
        gymnasium.register(
            id=AUV_DROPOUT,
            entry_point="navgym.envs.auv:AUVDropoutEnv",
            vector_entry_point="navgym.envs.auv:AUVDropoutVectorEnv",
        )
