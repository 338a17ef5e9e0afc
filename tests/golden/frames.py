#!/usr/bin/env python3
"""Writes frames.hex: one whole frame of every message, from the protocol's description alone.

Shares nothing with the Rust code: the CRC is zlib's, COBS, varints and layouts are written out here.
Run it only when the protocol changes: `python3 tests/golden/frames.py > tests/golden/frames.hex`.
"""

import struct
import zlib


def u8(x):
    return bytes([x])


def uint(x):
    """postcard's varint: seven bits a byte, low bits first (u16, u32, u64, enum variants)."""
    out = bytearray()
    while x >= 0x80:
        out.append(x & 0x7F | 0x80)
        x >>= 7
    out.append(x)
    return bytes(out)


def sint(x):
    """Zigzag, then varint (i32)."""
    return uint(2 * x if x >= 0 else -2 * x - 1)


def f32(*xs):
    return b"".join(struct.pack("<f", x) for x in xs)


def text(s):
    return s.encode().ljust(16, b"\0")


def cobs(data):
    out = bytearray()
    block = bytearray()
    for byte in data:
        if byte == 0:
            out += bytes([len(block) + 1]) + block
            block = bytearray()
        else:
            block.append(byte)
            if len(block) == 254:
                out += bytes([255]) + block
                block = bytearray()
    return bytes(out + bytes([len(block) + 1]) + block)


def frame(kind, session, sequence, console_time_us, body):
    version = 0
    packet = struct.pack("<BBIIQ", version, kind, session, sequence, console_time_us) + body
    return cobs(packet + struct.pack("<I", zlib.crc32(packet))) + b"\0"


def joint(k):
    return (
        f32(1000.0 * k) + sint(-k) + f32(0.25 * k, 2.5, 400.0, 3.0, 0.125 * k, 0.5, 0.0625)
    )


hello_host = uint(0x0123456789ABCDEF) + uint(0xDEADBEEF) + uint(0) + uint(1000) + uint(300) + u8(0) + text("")
hello_console = (
    uint(0x0123456789ABCDEF) + uint(0xDEADBEEF) + uint(0xC0FFEE) + uint(1000) + uint(300) + u8(1) + text("desk")
)
state = (
    uint(123456)
    + f32(0.125, -0.25, 0.5)
    + f32(0.0, 0.0, 0.0, 1.0)
    + f32(1.5, -0.0, -2.0)
    + f32(0.75, 0.0, -3.5)
    + f32(0.25, -0.25, 1.0)
    + uint(3)  # Decaying
    + uint(0b10001)  # E_STOP, BOARD
    + uint(77)
    + uint(33000)
    + uint(0xFFFFFFFF)
    + uint(0xFEDCBA9876543210)
)
contact = (
    u8(0)
    + f32(0.125, -0.25, 0.5)
    + f32(0.5, -0.5, 0.5, 0.5)
    + f32(0.0, 1.0, -2.0, 0.5, 0.25, -0.125)
    + f32(*[-8.0 * (k + 1) for k in range(21)])
    + f32(0.0)
    + f32(0.0, 0.0, 1.0)
    + f32(0.5)
    + uint(100000)
)
needle = (
    u8(0)
    + u8(3)
    + f32(0.125, -0.25, 0.5)
    + f32(0.5, -0.5, 0.5, 0.5)
    + f32(0.0, 0.75, -2.0, 125.0, 0.0, -0.0)
    + uint(1)  # Holding
    + uint(2)  # Backward
    + f32(-0.375)
    + f32(0.5, 0.25)
    + f32(256.0, 64.0)
    + f32(0.0625)
    + f32(0.125)
    + f32(-0.3125)
    + u8(3)  # points forward, then backward
    + u8(1)
    + f32(0.0009765625, -0.5, 0.0009765625, -0.3125, 0.001953125, -0.34375)
    + f32(0.0001220703125, 0.25)
    + f32(*[0.0] * 16)
    + uint(100000)
)
thread = (
    u8(0)
    + u8(2)
    + uint(1)  # Head
    + uint(1)  # Taut
    + f32(0.125, -0.25, 0.5)
    + f32(0.0, -1.0, -0.0)
    + f32(1.5)
    + f32(512.0)
    + f32(0.0)
    + uint(100000)
)
row = lambda kind, k, force: kind + f32(-0.25 * k, force) + f32(0.0, -0.5 * k, -1.0, 0.125, k, -0.0)
rows = (
    u8(0)
    + f32(*[8.0 * (k + 1) for k in range(21)])
    + f32(125.0)
    + uint(4)
    + row(uint(0) + uint(3), 1, 0.75)  # Smooth
    + row(uint(1) + uint(70000) + f32(0.5), 2, 2.0)  # Normal
    + row(uint(2) + f32(-0.125), 3, -0.5)  # Tangent
    + row(uint(2) + f32(0.0), 4, 0.0)
    + uint(10)
    + f32(0.5, 0.25, -0.125, 0.0, 0.5, 0.0625, -0.0, 1.0, 0.03125, 2.0)
)
report = (
    b"".join(uint(x) for x in [100000, 1, 2, 30000, 4, 5, 300])
    + u8(4)  # Crc
    + u8(1)  # power
    + u8(2)  # hard fault
    + uint(0x08001234)
    + uint(4096)
    + uint(2400)
)
serial_arm = uint(1) + f32(0.0, 0.0, 0.25) + f32(0.125, 0.25)
cartesian = uint(0) + f32(-1.0, 0.0, 0.5)


def device(kinematics):
    joints = joint(1) + joint(2) + joint(3)
    return text("bras é") + kinematics + joints + f32(0.0, 0.5, 0.25) + f32(12.0, 6.0, 1.5) + uint(1000)


hand = (
    f32(200.0, 2.0)
    + f32(0.0, 0.5, -0.5)
    + u8(3)
    + b"".join(f32(0.5 * k, 0.25, 0.0, -0.125 * k) if k < 3 else f32(0, 0, 0, 0) for k in range(12))
)

fixture_wall = uint(1) + f32(0.0, 0.0, -0.125) + f32(0.0, 0.0, 1.0) + f32(800.0, 2.0)
fixture_coupling = uint(2) + f32(0.25, -0.5, 0.0) + f32(400.0, 1.5)

FRAMES = [
    ("hello_host", frame(1, 0, 0, 0, hello_host)),
    ("hello_console", frame(1, 0, 0, 5_000_000_000, hello_console)),
    ("state", frame(2, 0xC0FFEE, 1, 123_456_000, state)),
    ("contact", frame(3, 0xC0FFEE, 2, 123_423_000, contact)),
    ("needle", frame(17, 0xC0FFEE, 12, 123_423_000, needle)),
    ("thread", frame(18, 0xC0FFEE, 13, 123_423_000, thread)),
    ("rows", frame(16, 0xC0FFEE, 14, 123_423_000, rows)),
    ("fixture_none", frame(20, 0xC0FFEE, 15, 0, uint(0))),
    ("fixture_wall", frame(20, 0xC0FFEE, 16, 0, fixture_wall)),
    ("fixture_coupling", frame(20, 0xC0FFEE, 17, 0, fixture_coupling)),
    ("command_arm", frame(4, 0xC0FFEE, 3, 0, uint(0))),
    ("command_disarm", frame(4, 0xC0FFEE, 4, 0, uint(1))),
    ("command_clear_fault", frame(4, 0xC0FFEE, 5, 0, uint(2))),
    ("command_state_every", frame(4, 0xC0FFEE, 6, 0, uint(3) + uint(1000))),
    ("report", frame(5, 0xC0FFEE, 0xFFFFFFFF, 2**63, report)),
    ("simulate_device_cartesian", frame(6, 0xC0FFEE, 7, 0, uint(0) + device(cartesian))),
    ("simulate_device_serial_arm", frame(6, 0xC0FFEE, 8, 0, uint(0) + device(serial_arm))),
    ("simulate_hand", frame(6, 0xC0FFEE, 9, 0, uint(1) + hand)),
    ("simulate_emergency_stop", frame(6, 0xC0FFEE, 10, 0, uint(2) + u8(1))),
    ("simulate_encoder_offset", frame(6, 0xC0FFEE, 11, 0, uint(3) + sint(-1) + sint(2**31 - 1) + sint(-(2**31)))),
]

print("# Whole frames of protocol draft 0, by frames.py: name, bytes in hex.")
for name, data in FRAMES:
    print(name, data.hex())
