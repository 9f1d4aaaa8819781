"""The end-to-end checks of the own protocol: SAE J1850 CRC-8, and a CRC-16 where a frame is longer.

CRC-8 finds any two wrong bits in up to 255 (Hamming distance 3); with its 224 bits, check included 240, the
command of layout fd has a CRC-16 that finds any four (Hamming distance 5). Polynomial 0x5935 is that of P.
Koopman's tables (0xAC9A in his notation, the best of 16 bits for up to 241 bits of data); CCITT's 0x1021
finds three. `tests/drivers/test_crc.py` counts it out.
"""

POLYNOMIAL = 0x1D
"""x^8 + x^4 + x^3 + x^2 + 1."""
START = 0xFF
FINAL_XOR = 0xFF
POLYNOMIAL_16 = 0x5935
"""x^16 + x^14 + x^12 + x^11 + x^8 + x^5 + x^4 + x^2 + 1."""
START_16 = 0xFFFF


def _remainder(byte: int, polynomial: int, bits: int) -> int:
    """Return byte * x^bits modulo a polynomial of that degree."""
    register = byte << bits - 8
    for _ in range(8):
        register <<= 1
        if register >> bits:
            register ^= 1 << bits | polynomial
    return register


# Lists, not bytes: the interpreter indexes them a third faster.
TABLE = [_remainder(byte, POLYNOMIAL, 8) for byte in range(256)]
"""The register goes from r to TABLE[r ^ byte]."""
TABLE_16 = [_remainder(byte, POLYNOMIAL_16, 16) for byte in range(256)]
"""The register goes from r to (r << 8) ^ TABLE_16[(r >> 8) ^ byte], 16 bits of it."""
RESIDUE = TABLE[FINAL_XOR]
"""The register after every message that ends in its own CRC-8."""


def crc8(data: bytes, state: int = START) -> int:
    """Return the CRC-8 of `data`, most significant bit first.

    SAE J1850: polynomial 0x1D, start 0xFF, final XOR 0xFF; the check value of b"123456789" is 0x4B.
    `state` continues from a register state, see `identifier_state`.
    """
    table = TABLE
    for byte in data:
        state = table[state ^ byte]
    return state ^ FINAL_XOR


def identifier_state(identifier: int) -> int:
    """Return the register after the two bytes of a CAN identifier, low byte first.

    Starting `crc8` from here mixes the identifier into the check: a frame that was sent or
    routed under another identifier fails it.
    """
    return crc8(identifier.to_bytes(2, "little")) ^ FINAL_XOR


def crc16(data: bytes, state: int = START_16) -> int:
    """Return the CRC-16 of `data`, most significant bit first.

    Polynomial 0x5935, start 0xFFFF, no final XOR; the check value of b"123456789" is 0x772B, that of
    CRC-16/M17. To mix an identifier in, continue from the CRC-16 of its two bytes, low byte first.
    """
    table = TABLE_16
    for byte in data:
        state = state << 8 & 0xFF00 ^ table[state >> 8 ^ byte]
    return state
