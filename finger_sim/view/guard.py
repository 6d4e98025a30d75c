"""Who may ask: Host, Origin and token of every request; and the headers of every answer.

Any page that a browser shows may send requests to this machine. Host tells by which name it was called (a name that
another's DNS gives to this machine is refused), Origin which page asks. At any address but this machine's own a token
is needed, too, as others may call.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Sequence
from urllib.parse import parse_qs, urlsplit

HEADERS = (
    (
        "Content-Security-Policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("X-Content-Type-Options", "nosniff"),
    ("X-Frame-Options", "DENY"),
    ("Referrer-Policy", "no-referrer"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    ("Cross-Origin-Opener-Policy", "same-origin"),
    ("Cache-Control", "no-store"),
)
"""Of every answer."""
OWN_NAMES = ("127.0.0.1", "localhost", "::1")
"""Of this machine, for itself."""
TOKEN_BYTES = 24


class Guard:
    """Judges requests to a server at `address`.

    token : that is needed; None at an address that only this machine reaches
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self.token = None if is_loopback(address) else secrets.token_urlsafe(TOKEN_BYTES)

    def refusal(self, host: Sequence[str], origin: Sequence[str]) -> str | None:
        """Why a request with these values of the headers Host and Origin is refused; None if it is not."""
        if len(host) != 1:
            return "a request needs one header Host"
        if not self._knows(_name(host[0])):
            return f"Host {host[0][:80]!r} is not this server's"
        if len(origin) > 1 or (origin and origin[0] not in (f"http://{host[0]}", f"https://{host[0]}")):
            return f"Origin {origin[0][:80]!r} is not this server's page"
        return None

    def lacks_token(self, query: str) -> str | None:
        """Why a request with this query is refused where a token is needed; None if it is not."""
        if self.token is None:
            return None
        given = parse_qs(query).get("token", [""])
        if len(given) == 1 and hmac.compare_digest(given[0].encode(), self.token.encode()):
            return None
        return "a token is needed: open the address that finger_sim view printed"

    @property
    def query(self) -> str:
        """What an address of this server ends with."""
        return "" if self.token is None else f"?token={self.token}"

    def _knows(self, name: str) -> bool:
        """Whether a name is this server's. Where a token is needed, an address is as good as any: nobody's DNS is."""
        if name in OWN_NAMES:
            return True
        if self.token is None:
            return name == self._address
        own = socket.gethostname().lower()
        return name in (self._address, own, f"{own}.local") or _is_address(name)


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches an address."""
    return address == "localhost" or (_is_address(address) and ipaddress.ip_address(address).is_loopback)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _name(host: str) -> str:
    """The name in a header Host, without its port; "" where there is none."""
    try:
        parts = urlsplit(f"//{host}")
        return "" if parts.path or parts.query or "@" in host else (parts.hostname or "")
    except ValueError:
        return ""
