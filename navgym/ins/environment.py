"""`navgym/INSDropout-v0`: what stands in for a lost Doppler log. Single and batch face."""

from __future__ import annotations

from navgym.envs.faces import LaneEnv, LaneVectorEnv
from navgym.ins.engine import InsEngine
from navgym.ins.settings import INSDropoutSettings
from navgym.problem import lazy


class INSDropoutEnv(LaneEnv):
    """Choose how much the last velocity is worth while a Doppler log is silent.

    ## Description
    An AUV navigates by an inertial measurement unit and a Doppler velocity log, with depth and a
    magnetometer. A closed-loop error-state Kalman filter of 22 states (QIVBF eq. 3-4, corrected) holds
    position, velocity, attitude, biases and calibrations. When the log is silent, the last velocity that it
    measured may stand in for it. That helps while the vehicle keeps its way, and harms once it turns or
    changes its speed. The agent says what it is worth, once per second, from what the filter itself
    knows. It never changes the truth or the measurements.

    | fact | value |
    |---|---|
    | task | dynamic algorithm configuration of a filter, one mission per episode |
    | cost | squared error of the horizontal velocity against a filter with fixed parameters on the same mission |
    | parameters | `fill_variance`; any of `navgym.parameter_space("ins_kf")` |
    | state information | time and turn since the loss, accelerometers, innovations, covariance; never the truth |
    | noise level | low within a second, high over an outage: what a velocity is worth shows later |
    | instances | missions of a scenario, split into train, validation and test by seed |

    ## Action Space
    `Box(-1, 1, (k,), float32)`, an element per name in `action_parameters`. With
    `action="absolute"`, -1 and 1 are the ends of the parameter's range and the way between is linear in
    its own scale; with `action="residual"`, 0 is the reference parameter and 1 is half the range away.
    Values outside are clipped. A held velocity is taken once per second, and is wrong the same way for
    minutes: 10 m²/s² still pull, 1000 are as good as nothing standing in. What grows with the silence,
    `fill_growth`, comes on top. `fill` itself is the reference's, "hold" in the scenarios with outages.

    {parameters}

    ## Observation Space
    `Box(-5, 5, (13 + k,), float32)`. The twin is the reference filter on the same mission with nothing
    standing in: how its velocity has changed is what the accelerometers foretell, and its spread is how
    little that is worth.

    | index | name | unit | range | meaning |
    |---|---|---|---|---|
    | 0 | since | ln s | 0 to 5 | logarithm of 1 + the time since the log last spoke |
    | 1 | turned | 90° | 0 to 2 | the furthest that the vehicle has turned since |
    | 2 | change | .3 m/s | 0 to 5 | how far the filter's body velocity is from what the log last said |
    | 3 | twin.change | .3 m/s | 0 to 5 | the same of the twin |
    | 4 | spread | 1 | -5 to 5 | half the logarithm of the velocity's variance over (.05 m/s)² |
    | 5 | twin.spread | 1 | -5 to 5 | the same of the twin |
    | 6 | jolt | .3 m/s | 0 to 5 | how far the twin's body velocity has changed while the log is silent, forgotten in 30 s, so that biases count little |
    | 7 | jolt.most | .3 m/s | 0 to 5 | the most of it since the log last spoke |
    | 8, 9 | log_nis | 1 | -1.5 to 5 | NIS per degree of freedom, exponential means of .8 and .97 |
    | 10 | lost | 1 | 0 to 1 | share of silent steps lately |
    | 11 | rate | .1 rad/s | 0 to 5 | rate of turn |
    | 12 | shake | 1 | -1.5 to 5 | half the logarithm of the accelerometers' noise over the model's |
    | 13- | parameter.* | 1 | -1 to 1 | parameters in force, in their range |

    ## Rewards
    `reward="relative"` (default): the reference filter's squared error of horizontal velocity over the
    decision less the filter's own, over the reference's mean over the mission, clipped to plus or minus
    `reward_clip`. Position integrates velocity, and would credit a decision with what came before it. What is
    best for velocity is not quite best for position: a filter that knows how little it knows puts its
    position right once the log speaks again, and this reward is blind to that.
    `"position"`: by how much the squared error of horizontal position grew more in the reference filter than
    in the filter's own, over the reference's mean: it sees that, and needs a discount that looks ahead for
    minutes. `"absolute"`: minus the RMS error of velocity, m/s. `"likelihood"`: mean log-likelihood of the
    innovations less the reference filter's, for recordings without truth.

    ## Starting State
    The reference filter runs for `warmup` seconds first: before, biases are still being found.
    `reset(options={{"start": k}})` takes k filter steps instead, and `options={{"recording": i}}` chooses a
    recording of the pool.

    ## Episode End
    `terminated` if the filter diverges (a covariance loses definiteness, or innovations run away a hundred
    times beyond S): the reward is then -`reward_clip`. `truncated` at the recording's end.

    ## Information
    RMS errors over the decision and those of the reference filter, `position_rmse` (m), `velocity_rmse` (m/s),
    `reference_*`; `nis` per degree of freedom, `silence` (s), `regime` (for analysis only: a policy must
    not see it), `reward_term` before clipping, and every parameter in physical units. `reset` returns what
    the recording is.

    ## Arguments
    {arguments}

    ```python
    >>> import gymnasium, navgym
    >>> env = gymnasium.make("navgym/INSDropout-v0", overrides={{"duration": 330.0}})
    >>> obs, info = env.reset(seed=1)
    >>> obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    >>> obs.shape, terminated
    ((14,), False)

    ```

    ## Version History
    * v0: first version
    """

    SETTINGS = INSDropoutSettings
    ENGINE = InsEngine
    PAINTER = lazy("navgym.ins.painter:InsPainter")


class INSDropoutVectorEnv(LaneVectorEnv):
    """The batch face of `INSDropoutEnv`; see `LaneVectorEnv`.

    Args:
        num_envs: number of lanes.
        max_episode_steps: truncate episodes after this many decisions, or None.
        arguments: those of `INSDropoutEnv`.
    """

    SETTINGS = INSDropoutSettings
    ENGINE = InsEngine
    PAINTER = lazy("navgym.ins.painter:InsPainter")
