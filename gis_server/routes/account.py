"""Who a token belongs to, and what it lets them do."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Response
from pydantic import BaseModel

from solmap.gis_server.access import Holder

router = APIRouter(prefix="/api", tags=["account"])


class Account(BaseModel):
    """The holder of a token."""

    name: str
    role: Literal["viewer", "analyst", "operator"]
    ends_at: str | None
    """UTC, ISO 8601; null: never."""


@router.get("/account")
def account(who: Holder, response: Response) -> Account:
    """Whose token the request shows; 401 or 403 says why there is none."""
    response.headers["Cache-Control"] = "no-store"
    return Account.model_validate({"name": who.name, "role": str(who.role), "ends_at": who.ends_at})
