"""Tokens on requests: who asks, and whether they may.

Reading is open to all. Writing takes a token with a role, in the header
`Authorization: Bearer solmap_...`; no cookie is ever set, so no other site makes a browser write.
Where nobody has a token nothing can be written at all.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, HTTPException, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from gis_server.services import ServicesOf
from products.access import Role, Token

_BEARER = HTTPBearer(auto_error=False, description="a token of `solmap token add`")
_CHALLENGE = {"WWW-Authenticate": "Bearer"}


def _holder(
    request: Request,
    services: ServicesOf,
    shown: Annotated[HTTPAuthorizationCredentials | None, Depends(_BEARER)],
) -> Token:
    """Whose token a request shows.

    Raises:
        HTTPException: 403 where nobody can have one, 401 where it shows none or a wrong one.
    """
    if not any(token.is_valid for token in services.tokens.tokens()):
        raise HTTPException(
            403,
            "this server only reads: nobody has a token; who runs it makes one with "
            "`solmap token add NAME --role analyst`",
        )
    if shown is None:
        raise HTTPException(
            401,
            f"{request.method} takes a token: send the header `Authorization: Bearer solmap_...`",
            _CHALLENGE,
        )
    token = services.tokens.holder(shown.credentials)
    if token is None:
        raise HTTPException(
            401, "this token is unknown, revoked or has ended; ask for another", _CHALLENGE
        )
    return token


Holder = Annotated[Token, Depends(_holder)]
"""Whoever asks, with any role."""


class Requires:
    """A dependency that lets holders of a role pass, and of those above it."""

    def __init__(self, role: Role) -> None:
        self._role = role

    def __call__(self, token: Holder) -> Token:
        """The token that is shown.

        Raises:
            HTTPException: 403, its role does not reach.
        """
        if token.role < self._role:
            raise HTTPException(
                403, f"this takes the role {self._role}, and {token.name} has {token.role}"
            )
        return token


Analyst = Annotated[Token, Depends(Requires(Role.ANALYST))]
Operator = Annotated[Token, Depends(Requires(Role.OPERATOR))]
