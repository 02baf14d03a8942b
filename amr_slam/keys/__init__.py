"""Who may do what on the fleet's network: a site's certificate authority and its access rules.

``amr-slam keys`` writes folders: one for the router, one for each robot, controller and
camera system. Each robot may publish its own keys and nothing else, only named controllers may
command, and who has no certificate of the site is not let in (docs/security.md).
"""

from amr_slam.credentials import Credentials, CredentialsError, read_credentials
from amr_slam.keys.files import KeysError
from amr_slam.keys.site import Member, Site, create, load

__all__ = [
    "Credentials",
    "CredentialsError",
    "KeysError",
    "Member",
    "Site",
    "create",
    "load",
    "read_credentials",
]
