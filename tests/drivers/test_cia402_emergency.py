"""Error codes of EMCY messages: which have a meaning of their own, and by which class the others are told."""

from __future__ import annotations

from drivers.cia402.states import meaning

OWN = (
    *(0x2310, 0x2320, 0x3110, 0x3120, 0x3210, 0x3220, 0x4210, 0x4310, 0x5441, 0x7121, 0x7305, 0x7310, 0x7380),
    *(0x8110, 0x8120, 0x8130, 0x8140, 0x8150, 0x8210, 0x8220, 0x8250, 0x8311, 0x8400, 0x8500, 0x8611, 0x8612),
    0x8700,
)
"""Of CiA 301, table 26, and of CiA 402-2: the codes that have a row here."""
CLASSES = {
    0x00: (),
    0x10: (),
    0x20: (0x21, 0x22, 0x23),
    0x30: (0x31, 0x32, 0x33),
    0x40: (0x41, 0x42, 0x43),
    0x50: (),
    0x60: (0x61, 0x62, 0x63),
    0x70: (0x71, 0x73),
    0x80: (0x81, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87),
    0x90: (),
    0xA0: (),
    0xF0: (0xFF,),
}
"""First two digits: the class, and what is more exact within it."""


def of_class(digits: int) -> str:
    """Return the meaning of a code of a class that has no row."""
    return meaning(digits << 8 | 0xEE)


def test_a_code_has_a_meaning_of_its_own_where_the_documents_give_it_one_and_no_other_has():
    assert tuple(code for code in range(1 << 16) if meaning(code) != of_class(code >> 8)) == OWN
    assert len({meaning(code) for code in OWN}) == len(OWN)


def test_a_code_without_a_row_is_told_by_its_first_two_digits_else_by_the_first():
    assert {of_class(digits) for digits in (0x00, 0x0F, 0xA0, 0xEF)} == {"unknown"}
    for whole, parts in CLASSES.items():
        inside = range(whole, whole + 0x10)
        assert tuple(digits for digits in inside if of_class(digits) != of_class(whole)) == parts
    told = {of_class(digits) for whole, parts in CLASSES.items() for digits in (whole, *parts)}
    assert len(told) == 32 + 1, "no two classes are told alike, and one is unknown"
