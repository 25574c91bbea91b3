"""Templates as rows of a program's own database, searched in memory: it keeps no pictures.

    pip install sqlalchemy "psycopg[binary]"
    python examples/own_database.py postgresql+psycopg://shop@localhost/shop
    python examples/own_database.py sqlite://  # in memory

Two prints of simulated fingers are enrolled as rows, and a third press of one of them is searched.
Run on PostgreSQL 15.18 (SQLAlchemy 2.1.9, psycopg 3.3.9) and SQLite.
Make `Candidates` once, when the program starts: the first search among many makes an index.
"""

from __future__ import annotations

import argparse

import numpy as np
from sqlalchemy import LargeBinary, create_engine, select
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column

import splitknit_match
from splitknit import BadInput
from splitknit_simulator.finger.master_print import MasterPrintSettings, ink_print, master_print

PPI = 500
SIZE = MasterPrintSettings(half_width_mm=7.0, distal_mm=16.0, proximal_mm=1.0)


class Base(DeclarativeBase):
    """The program's tables."""


class Customer(Base):
    """One row a customer."""

    __tablename__ = "customer"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str]
    template: Mapped[bytes] = mapped_column(LargeBinary)


def enrol(
    session: Session, candidates: splitknit_match.Candidates, name: str, print_: np.ndarray
) -> None:
    """Keep a customer's template as a row, and search it from now on."""
    template = splitknit_match.make_template(print_, resolution_ppi=PPI)
    if not template.a.acquired:
        raise BadInput("no ridges: capture the finger again.")
    customer = Customer(name=name, template=template.payload)
    session.add(customer)
    session.commit()
    candidates.add({str(customer.id): template.payload})


def whose(
    session: Session, candidates: splitknit_match.Candidates, print_: np.ndarray
) -> Customer | None:
    """The customer whose finger it is, decided at the default false match rate."""
    search = candidates.search(print_, resolution_ppi=PPI)
    if search.answer != "match":
        return None
    return session.get(Customer, int(search.candidates[0].person))


def press(seed: int, shift_px: int = 0) -> np.ndarray:
    """A simulated print (H, W) uint8, ridges dark."""
    image = np.pad(ink_print(master_print("left_loop", seed, SIZE)), 20, constant_values=255)
    return np.roll(image, shift_px, axis=1)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("database", help="SQLAlchemy's URL")
    engine = create_engine(parser.parse_args(arguments).database)
    Base.metadata.create_all(engine)
    with Session(engine) as session:
        rows = session.execute(select(Customer.id, Customer.template))
        candidates = splitknit_match.Candidates({str(key): bytes(row) for key, row in rows})
        for name, seed in (("Ann", 1), ("Bob", 2)):
            enrol(session, candidates, name, press(seed))
        customer = whose(session, candidates, press(2, 9))
        print("Nobody" if customer is None else customer.name, "of", len(candidates), "customers")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
