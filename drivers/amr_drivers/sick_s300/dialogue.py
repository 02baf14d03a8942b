"""What to ask a scanner in request mode, and what its answers mean for the token. Pure."""

from __future__ import annotations

from amr_drivers.sick_s300.requests import (
    BUSY,
    TOKEN_TAKEN,
    Answer,
    Request,
    fetch_scan,
    get_token,
    release_token,
)


class Dialogue:
    """Get the token, fetch, fetch, ... (fact sheet, A.6).

    A token that is taken was left by a program that died, and nobody documents that it times out:
    it is released and got anew. A fetch that is refused means that the token is gone (the scanner
    was switched off and on).
    """

    def __init__(self, address: int, beams: int) -> None:
        self._get = get_token(address)
        self._fetch = fetch_scan(address, beams)
        self._release = release_token(address)
        self._next = self._get
        self._may_hold = False

    @property
    def next_request(self) -> Request:
        """What to send next."""
        return self._next

    @property
    def farewell(self) -> Request | None:
        """What to send before hanging up: None where the token cannot be ours."""
        return self._release if self._may_hold else None

    def sent(self, request: Request) -> None:
        """From now on the token may be ours, even when its answer is lost."""
        self._may_hold = (self._may_hold or request.takes_token) and not request.releases_token

    def answered(self, request: Request, answer: Answer) -> None:
        """Go on from an answer; without one, the same request comes again."""
        if request.releases_token:
            self._next = self._get
        elif answer.code == 0:
            self._next = self._fetch
        elif request.takes_token:
            self._next = self._release if answer.code == TOKEN_TAKEN else self._get
        elif answer.code != BUSY:
            self._next = self._get
