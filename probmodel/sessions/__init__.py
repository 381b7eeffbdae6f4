"""Sessions of calibrated cameras: a person seen from several sides, and so in three dimensions."""

from poseterior.probmodel.sessions.pinhole import Pinhole
from poseterior.probmodel.sessions.session import Session, is_session, read_session
from poseterior.probmodel.sessions.triangulation import Triangulated, triangulate

__all__ = ["Pinhole", "Session", "Triangulated", "is_session", "read_session", "triangulate"]
