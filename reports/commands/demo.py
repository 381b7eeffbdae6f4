"""`poseterior demo`: the main job on the embedded example, with the true pose beside the
hypotheses."""

from poseterior.probmodel.example import example
from poseterior.reports.commands import hypotheses
from poseterior.reports.options import Drawing, PersonOrSession, Sampling, Screen
from poseterior.reports.settings import DemoSettings, HypothesesSettings


def run(settings: DemoSettings, screen: Screen) -> None:
    """Draws 10,000 poses and chooses five for the example, the paper's way: one pose of motion
    capture, one wrist missing."""
    made = example()
    wanted = HypothesesSettings(
        person=PersonOrSession(file=made.path),
        out=settings.out,
        open=settings.open,
        sampling=Sampling(seed=settings.seed),
        rooting=Drawing(root=settings.drawn),
    )
    hypotheses.run(wanted, screen, truth=made.joints)
