"""Gymnasium environments; importing `navgym` registers them."""

from __future__ import annotations

# id: module and name of the single environment; its vector face is called ...VectorEnv
ENVIRONMENTS = {
    "navgym/AUVDropout-v0": "navgym.envs.auv:AUVDropout",
    "navgym/DeckDeformation-v0": "navgym.envs.deck:DeckDeformation",
}


def register_all() -> None:
    """Register every environment of navgym with Gymnasium; doing it twice changes nothing."""
    import gymnasium

    for name, where in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name, entry_point=f"{where}Env", vector_entry_point=f"{where}VectorEnv"
            )
