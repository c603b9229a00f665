"""What each paper prints, figure by figure and number by number, and why what holds of it holds.

What holds is found by running: `Finding`. The words are ours; equations, tables and figures carry
the papers' numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

HOLDS, PARTLY, FAILS = "holds", "holds in part", "does not hold"
OPEN = "cannot be judged"  # rests on recordings that are not public
TAKEN = "taken over"  # a setting, not a claim
VERDICTS = (HOLDS, PARTLY, FAILS, OPEN, TAKEN)


@dataclass(frozen=True)
class Claim:
    """Something that a paper prints.

    Args:
        paper: "QIVBF" or "IDAM".
        where: "figure 4", "table 1", "section 5 (numbers)".
        says: what it shows or claims.
        why: the reason for what we find, and where the whole of it stands.
    """

    paper: str
    where: str
    says: str
    why: str


@dataclass(frozen=True)
class Finding:
    """What holds of a claim.

    Args:
        claim: what was looked at.
        verdict: one of `VERDICTS`.
        found: the numbers behind the verdict, in a sentence or two.
    """

    claim: Claim
    verdict: str
    found: str

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict must be one of {VERDICTS}, got {self.verdict!r}.")

    def told(self) -> list[str]:
        """Claim, what holds and why, as paragraphs of a report."""
        where = self.claim.where[0].upper() + self.claim.where[1:]
        return [
            f"**{where}** {self.claim.says}",
            f"**It {self.verdict}.** {self.found}"
            if self.verdict in (HOLDS, PARTLY, FAILS, OPEN)
            else self.found,
            f"**Why:** {self.claim.why}",
        ]


def judge(*parts: bool) -> str:
    """All of a claim's parts hold, some, or none."""
    return HOLDS if all(parts) else PARTLY if any(parts) else FAILS


def _qivbf() -> dict[str, Claim]:
    page = "docs/science/qivbf.md"
    axis = (
        "The paper's Kalman filter takes a lost measurement for a zero (eq. 2), which pulls the state "
        f"to the origin. A flag in its place, and predicting through the gap, is all it needs ({page}, Errata)."
    )
    told = {
        "figure 1": (
            "draws the basis polynomials by which the last three values supply a lost one.",
            "The weights are right where the last three samples were received. Over a gap they must be "
            "taken at the received samples' own times, and what comes out is a function of past data with "
            f"Σl² times their noise, not a measurement ({page}, Extrapolation).",
        ),
        "table 1": (
            "gives the algorithm as pseudocode, to be run as it stands.",
            "Its predicted covariance is of rank one and forgets P, every sweep counts the same sample "
            f"again, and nothing forgets an old R ({page}, Errata: table 1, eq. 34-40).",
        ),
        "table 2": (
            "gives P0, Q and R. The print leaves open the sampling time, the number of samples, the loss "
            "rate, x0, the number of sweeps N_VB and every prior of the variational step.",
            "A figure that rests on open values can be compared in kind, not to a digit.",
        ),
        "section 3": (
            "derives a filter that alternates unscented and cubature updates (CUKF), for accuracy that "
            "the unscented filter alone lacks.",
            "Both rules integrate the same second moments; what sets them apart is of higher order than a "
            "turn at these noise levels shows. With the signs as printed (eq. 16, 26) every run diverges "
            f"({page}, Errata).",
        ),
        "equations 3-4": (
            "give the error model of an INS with Doppler log, magnetometer and depth that the filter is for; nothing "
            "in the paper is run on it.",
            "Signs, axes and blocks are wrong in the print (docs/science/ins.md, Errata); corrected, the model is linear "
            "given the nominal, and its covariance can be held against its errors.",
        ),
        "conclusion": (
            "claims that QIVBF is much better than the Kalman filter where measurements are lost.",
            "A lost Doppler velocity is bridged by the IMU: what a parabola through the last three adds is noise times Σl². "
            "Estimating R pays where the noise changes, lost or not (docs/science/ins.md).",
        ),
        "figure 2": ("shows the position in x: QIVBF on the reference, the Kalman filter off it.", axis),
        "figure 3": ("shows the position in y: as in x.", axis),
        "figure 4": (
            "shows RMSE(k) of eq. 43: lower for QIVBF, while the Kalman filter diverges once measurements "
            "are missing, for want of a right gain.",
            "With |eig F| = 1 and every state measured, a filter that predicts through losses is bounded at "
            "any loss rate below 1 (docs/science/external-truths.md, Loss bounds), and where the model is right no fill "
            "can add to it. The variational filter pays where the noise has heavy tails.",
        ),
    }  # fmt: skip
    return {where: Claim("QIVBF", where, says, why) for where, (says, why) in told.items()}


def _idam() -> dict[str, Claim]:
    page = "docs/science/idam.md"
    order = (
        "θ about z is known no better than σ/√(1 + βt/4) whatever the filter, and what separates the methods is smaller "
        f"than what separates two seeds ({page}, Information limit)."
    )
    closed = "The recordings are the authors' (available from them on request)."
    told = {
        "figure 1": (
            "shows how the flexure moves the lever arm, r = r0 + θ × r0 (eq. 4-7).",
            "The static deformation moves it too, and by more: Φ × r0 is left out of eq. 4-7 "
            f"({page}, Errata).",
        ),
        "figure 2": (
            "lays out identification on line: increments of both IMUs, their difference, its "
            "autocorrelation, the flexure's parameters.",
            "In body axes the increments carry δΘ × θ, as large as the signal, and the fit locks on to the "
            f"sway; in inertial axes they are those of θ ({page}, Increments).",
        ),
        "figure 3": (
            "lays out the relevance vector machine that is to identify better than existing methods.",
            "It smooths an autocorrelation, and a fit to that identifies: the length of the record sets "
            f"what can be known ({page}, Identification).",
        ),
        "section 4": (
            "claims a filter that is robust to shocks and model errors by correntropy and model prediction, "
            "at any mounting angle by Rodrigues parameters.",
            "Correntropy rejects what does not fit, wrong measurements and true slams alike; model "
            f"prediction uses each datum twice ({page}, Correntropy and model prediction). The measurement is "
            "linear in the Rodrigues parameters at any angle.",
        ),
        "section 5 (setting)": (
            "gives the ship, its sway, the IMUs, the flexure and the lever arm. The print leaves open the "
            "duration, the main IMU's grade, every prior and noise of the filter, the kernel width, the "
            "weight of model prediction and the window of identification.",
            "A figure that rests on open values can be compared in kind, not to a digit.",
        ),
        "figure 4": ("shows the deflection angle: IDAM follows it best, above all about z.", order),
        "figure 5": (
            "shows the attitude error, whole (a) and enlarged (b): IDAM has the smallest.",
            "The total attitude hardly needs θ: what is wrong in θ is taken back by the constant that goes "
            f"with it ({page}, What the attitude is).",
        ),
        "figure 6": (
            "shows the RMSE by axis: IDAM has the smallest about every axis.",
            order,
        ),
        "section 5 (numbers)": (
            "prints 4.260′ about z for IDAM, 5.032′ for WOAM, 6.560′ for SVRAM, hence gains of 15.34 and "
            "35.06 %.",
            "4.260′ is the information limit of that axis, so it is right for any of them. The order rests on one "
            "run each.",
        ),
        "table 1": (
            "lists what was logged at sea: two IMUs, two reference units, GNSS, with units and rates.",
            "Everything that filter and reference need is in it; the GNSS serves neither.",
        ),
        "table 2": (
            "gives how the IMUs sit on their reference units, pitch, roll and heading.",
            "Up to half a degree: it must be taken off before minutes of arc are compared.",
        ),
        "figure 7": ("shows the installation on board, in photographs.", closed),
        "figure 8": ("shows the track of the ship.", closed + " The filter needs no position."),
        "figure 9": (
            "shows attitude errors at sea: SVRAM far off, WOAM and IDAM alike in pitch and roll, WOAM off in "
            "heading around 150 s.",
            closed,
        ),
        "figure 10": (
            "prints RMSE at sea in roll, pitch and heading: SVRAM 5.155, 5.098, 25.143′, WOAM .828, 1.914, "
            "10.735′, IDAM .797, 1.852, 9.589′, and gains in per cent.",
            closed + " One passage cannot tell methods apart that differ by less than two passages do.",
        ),
    }  # fmt: skip
    return {where: Claim("IDAM", where, says, why) for where, (says, why) in told.items()}


QIVBF: Mapping[str, Claim] = _qivbf()
IDAM: Mapping[str, Claim] = _idam()
