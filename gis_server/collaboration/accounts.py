"""Tokens of requests: their owner, and the permissions of their role.

Reading is open to all. Writing needs a token with a role, in the header `Authorization: Bearer
solmap_...`; no cookie is set, so another site cannot make a browser write. A store without tokens
accepts no writes.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, HTTPException, Request, Response
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from pydantic import BaseModel

from solmap.gis_server.budgets import client_of
from solmap.gis_server.services import ServicesOf
from solmap.products.catalogue.tokens import Role, Token

_BEARER = HTTPBearer(auto_error=False, description="a token of `solmap token add`")
_CHALLENGE = {"WWW-Authenticate": "Bearer"}
MOST_WRONG, WITHIN_S = 20, 60.0
"""Most different wrong tokens from one address, and the period in seconds."""


class WrongTokens:
    """Counts wrong tokens by client address, and refuses guessers for a while.

    Right tokens are always accepted, also from an address that sends wrong ones.
    """

    def __init__(self) -> None:
        self._came: dict[str, deque[float]] = {}

    def wait_s(self, host: str) -> float:
        """Count a wrong token; returns the time for which this address is refused, or zero."""
        now = time.monotonic()
        for other in [key for key, times in self._came.items() if now - times[-1] > WITHIN_S]:
            del self._came[other]
        times = self._came.setdefault(host, deque(maxlen=MOST_WRONG))
        is_over = len(times) == MOST_WRONG and now - times[0] < WITHIN_S
        if is_over:
            return WITHIN_S - (now - times[0])
        times.append(now)
        return 0.0


_WRONG = WrongTokens()


def _token_of(
    request: Request,
    services: ServicesOf,
    shown: Annotated[HTTPAuthorizationCredentials | None, Depends(_BEARER)],
) -> Token:
    """The owner of the token of a request.

    Raises:
        HTTPException: 403 where no tokens exist, 401 without or with a wrong one, 429 after many
            wrong ones from the address.
    """
    if not any(token.is_valid for token in services.tokens.tokens()):
        raise HTTPException(
            403,
            "this server is read-only: no token exists; its operator makes one with `solmap "
            "token add NAME --role analyst`",
        )
    if shown is None:
        raise HTTPException(
            401,
            f"{request.method} needs a token: send the header `Authorization: Bearer solmap_...`",
            _CHALLENGE,
        )
    token = services.tokens.verify(shown.credentials)
    if token is None:
        wait_s = _WRONG.wait_s(client_of(request.scope))
        if wait_s:
            raise HTTPException(
                429,
                f"more than {MOST_WRONG} wrong tokens came in {WITHIN_S:.0f} s from your address",
                {"Retry-After": str(int(wait_s) + 1)},
            )
        raise HTTPException(
            401, "this token is unknown, revoked or expired; request another", _CHALLENGE
        )
    return token


Holder = Annotated[Token, Depends(_token_of)]
"""A client with any role."""


class Requires:
    """A dependency that admits holders of a role or a higher one."""

    def __init__(self, role: Role) -> None:
        self._role = role

    def __call__(self, token: Holder) -> Token:
        """The token of the request.

        Raises:
            HTTPException: 403, its role is insufficient.
        """
        if token.role < self._role:
            raise HTTPException(
                403, f"this requires the role {self._role}, and {token.name} has {token.role}"
            )
        return token


Analyst = Annotated[Token, Depends(Requires(Role.ANALYST))]
Operator = Annotated[Token, Depends(Requires(Role.OPERATOR))]
router = APIRouter(prefix="/api", tags=["account"])


class Account(BaseModel):
    """The holder of a token."""

    name: str
    role: Literal["viewer", "analyst", "operator"]
    ends_at: str | None
    """UTC, ISO 8601; null: never."""


@router.get("/account")
def account(who: Holder, response: Response) -> Account:
    """The owner of the request's token; 401 or 403 without one."""
    response.headers["Cache-Control"] = "no-store"
    return Account.model_validate({"name": who.name, "role": str(who.role), "ends_at": who.ends_at})
