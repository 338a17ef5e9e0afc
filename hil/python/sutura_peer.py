"""A host for a Sutura console in plain Python: frames, messages, sessions over a serial port.

Written from the protocol's page (docs/src/protocol.md) and nothing else; standard library only. Entry points: `encode`,
`decode`, `Host`. A dict stands for a struct, "Name" or {"Name": body} for a variant of an enum. press.py is a host made
with it. `python3 sutura_peer.py < frames.hex` shows frames, one of hex per line, as JSON.
"""

import contextlib
import errno
import json
import os
import select
import struct
import sys
import time
import zlib

VERSION = 1
# Of the messages below; a console with others refuses the session.
SCHEMA_HASH = 0x994DE167F5675D53
TICK_HZ, MAX_FRAME = 1000, 2333


def fields(text):
    """[(name, type)] of `name:type name:type ..`."""
    return [tuple(field.split(":")) for field in text.split()]


def units(text):
    return {number: (name, None) for number, name in enumerate(text.split())}


VEC3, WRENCH, TANGENT, PAIR = (("array", "f32", size) for size in (3, 6, 21, 2))
POSE = [("position_m", VEC3), ("orientation", ("array", "f32", 4))]
SPRING = fields("stiffness_n_per_m:f32 damping_n_s_per_m:f32")
COURSE = fields("forward:u8 backward:u8") + [("points", ("array", PAIR, 12))]
ROW_KIND = {0: ("Smooth", fields("id:u32")), 1: ("Normal", fields("id:u32 friction:f32")),
            2: ("Tangent", fields("anchor_m:f32"))}
ROW = [("kind", ROW_KIND), *fields("delta_free_m:f32 lambda_n:f32"), ("jacobian", WRENCH)]
KINEMATICS = {0: ("Cartesian", [("origin_m", VEC3)]),
              1: ("SerialArm", [("shoulder_m", VEC3), *fields("upper_m:f32 fore_m:f32")])}
JOINT = fields("counts_per_unit:f32 zero_counts:i32 effort_per_amp:f32 max_current_a:f32 max_slew_per_s:f32 "
               "max_speed_per_s:f32 inertia:f32 damping:f32 coulomb:f32")
DEVICE = [("name", "text"), ("kinematics", KINEMATICS), ("joints", ("array", JOINT, 3)), ("gravity_mass_kg", VEC3),
          *fields("max_force_n:f32 max_power_w:f32 max_grip_speed_m_per_s:f32 actuation_delay_us:u32")]
WAY_POINT = [("time_s", "f32"), ("position_m", VEC3)]
HAND = [*SPRING, ("start_joint", VEC3), ("count", "u8"), ("way_points", ("array", WAY_POINT, 12))]

# Kind and name, then the layout of the body.
LAYOUTS = {
    (1, "Hello"): fields("schema_hash:u64 nonce:u32 session:u32 tick_hz:u16 max_frame:u16 simulated:bool "
                         "device_name:text") + [("refusal", units("None Schema TickRate FrameSize Owned"))],
    (2, "State"): [("tick", "u32"), *POSE, ("velocity_m_per_s", VEC3), ("force_n", VEC3), ("current_a", VEC3),
                   ("mode", units("Boot Idle Armed Decaying Fault")),
                   *fields("faults:u16 contact_sequence:u32 contact_age_us:u32 applied_age_us:u32 trace_hash:u64"),
                   ("encoder_counts", ("array", "i32", 3)), *fields("inputs:u8 heard_sequence:u32")],
    (3, "Contact"): [("tool", "u8"), *POSE, ("wrench", WRENCH), ("tangent", TANGENT), ("gap_m", "f32"),
                     ("normal", VEC3), *fields("relaxation_per_s:f32 horizon_us:u32")],
    (4, "Command"): {**units("Arm Disarm ClearFault"), 3: ("StateEvery", fields("ticks:u16"))},
    (5, "Report"): fields("ticks:u32 tick_overruns:u32 ticks_late:u32 frames_received:u32 frames_lost:u32 "
                          "frames_rejected:u32 frames_superseded:u32 last_reject:u8 reset_cause:u8 epitaph_kind:u8 "
                          "epitaph_place:u32 stack_free_bytes:u32 tick_cost_max:u32"),
    (6, "Simulate"): {0: ("Device", DEVICE), 1: ("Hand", HAND), 2: ("EmergencyStop", "bool"),
                      3: ("EncoderOffset", ("array", "i32", 3))},
    (7, "Ping"): fields("host_us:u64"),
    (8, "Pong"): fields("host_us:u64 received_us:u64 sent_us:u64"),
    (16, "Rows"): [("tool", "u8"), ("held", TANGENT), ("curvature_per_m", "f32"), ("rows", ("list", ROW, 24)),
                   ("compliance", ("list", "f32", 300))],
    (17, "Needle"): [*fields("tool:u8 needle:u8"), ("slide", WRENCH), ("tip", units("Outside Holding Inside")),
                     ("friction", units("Sticks Forward Backward")), ("axial_n", "f32"), ("friction_n", PAIR),
                     ("stiffness_n_per_m", PAIR), *fields("hold_n:f32 puncture_n:f32 punctured_n:f32"),
                     ("course", COURSE)],
    (18, "Thread"): [*fields("tool:u8 thread:u8"), ("end", units("Tail Head")), ("state", units("Slack Taut Strained")),
                     ("direction", VEC3), *fields("tension_n:f32 stiffness_n_per_m:f32 slack_m:f32")],
    (20, "Fixture"): {0: ("None", None), 1: ("Wall", [("point_m", VEC3), ("normal", VEC3), *SPRING]),
                      2: ("Coupling", [("anchor_m", VEC3), *SPRING])},
}
KIND = {name: kind for kind, name in LAYOUTS}
NAME = {kind: name for kind, name in LAYOUTS}
LAYOUT = {name: layout for (_, name), layout in LAYOUTS.items()}
BITS = {"u16": 16, "u32": 32, "u64": 64}


class Refused(Exception):
    """A frame that is not right; nothing of it may be used."""


def encode_varint(value):
    out = b""
    while value >= 0x80:
        out, value = out + bytes([value & 0x7F | 0x80]), value >> 7
    return out + bytes([value])


def encode_value(layout, value):
    """One value in postcard."""
    if isinstance(layout, list):
        return b"".join(encode_value(part, value[name]) for name, part in layout)
    if isinstance(layout, dict):
        name, body = (value, None) if isinstance(value, str) else next(iter(value.items()))
        number, part = next((number, part) for number, (variant, part) in layout.items() if variant == name)
        return encode_varint(number) + (b"" if part is None else encode_value(part, body))
    if isinstance(layout, tuple):
        sort, part, size = layout
        if len(value) > size or (sort == "array" and len(value) != size):
            raise ValueError(f"{len(value)} items where {size} are due")
        items = b"".join(encode_value(part, item) for item in value)
        return (encode_varint(len(value)) if sort == "list" else b"") + items
    if layout == "f32":
        return struct.pack("<f", value)
    if layout in ("u8", "bool"):
        return bytes([int(value)])
    if layout == "text":
        return value.encode().ljust(16, b"\0")
    if layout == "i32":  # Zigzag.
        return encode_varint(2 * value if value >= 0 else -2 * value - 1)
    if not 0 <= value < 1 << BITS[layout]:
        raise ValueError(f"{value} is no {layout}")
    return encode_varint(value)


class Reader:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        self.at += count
        if self.at > len(self.data):
            raise Refused("body does not decode")
        return self.data[self.at - count:self.at]

    def varint(self, bits):
        value = 0
        for shift in range(0, bits, 7):
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << shift
            if byte < 0x80 and not value >> bits:
                return value
        raise Refused("body does not decode")

    def value(self, layout):
        if isinstance(layout, list):
            return {name: self.value(part) for name, part in layout}
        if isinstance(layout, dict):
            number = self.varint(32)
            if number not in layout:
                raise Refused("body does not decode")
            name, part = layout[number]
            return name if part is None else {name: self.value(part)}
        if isinstance(layout, tuple):
            sort, part, size = layout
            count = self.varint(32) if sort == "list" else size
            if count > size:
                raise Refused("body does not decode")
            return [self.value(part) for _ in range(count)]
        if layout == "f32":
            return struct.unpack("<f", self.take(4))[0]
        if layout in ("u8", "bool"):
            byte = self.take(1)[0]
            if layout == "bool" and byte > 1:
                raise Refused("body does not decode")
            return byte if layout == "u8" else byte == 1
        if layout == "text":
            try:
                return self.take(16).decode().rstrip("\0")
            except UnicodeDecodeError as error:
                raise Refused("a name is not UTF-8") from error
        if layout == "i32":
            value = self.varint(32)
            return (value >> 1) ^ -(value & 1)
        return self.varint(BITS[layout])


def stuff(data):
    """COBS (Cheshire and Baker 1999): no zeros; a block is its length, then bytes, then a zero unless it has 254."""
    out, block = bytearray(), bytearray()
    for byte in data:
        if byte:
            block.append(byte)
        if not byte or len(block) == 254:
            out += bytes([len(block) + 1]) + block
            block.clear()
    return bytes(out + bytes([len(block) + 1]) + block)


def unstuff(data):
    out, at = bytearray(), 0
    while at < len(data):
        size = data[at]
        block = data[at + 1:at + size]
        if size == 0 or len(block) < size - 1:
            raise Refused("cut short")
        at += size
        out += block
        if size < 255 and at < len(data):
            out.append(0)
    return bytes(out)


def encode(name, body, session=0, sequence=0, console_time_us=0):
    """A whole frame, delimiter included."""
    packet = struct.pack("<BBIIQ", VERSION, KIND[name], session, sequence, console_time_us)
    packet += encode_value(LAYOUT[name], body)
    return stuff(packet + struct.pack("<I", zlib.crc32(packet))) + b"\0"


def decode(frame):
    """Name of the message, its body, and the header's session, sequence and console time; `frame` without delimiter."""
    packet = unstuff(frame)
    if len(packet) < 4 or zlib.crc32(packet[:-4]) != struct.unpack("<I", packet[-4:])[0]:
        raise Refused("wrong checksum")
    if packet[0] != VERSION:
        raise Refused(f"protocol version {packet[0]}, not {VERSION}")
    if len(packet) < 22 or packet[1] not in NAME:
        raise Refused("unknown kind of message")
    _, kind, session, sequence, console_time_us = struct.unpack("<BBIIQ", packet[:18])
    reader = Reader(packet[18:-4])
    body = reader.value(LAYOUT[NAME[kind]])
    if reader.at != len(reader.data):
        raise Refused("bytes left after the body")
    return NAME[kind], body, session, sequence, console_time_us


class Busy(ConnectionError):
    """Another program has the port."""


def holder(port):
    """Who has the lock of an open port, as ` (name, process 123)`; empty where the system does not say."""
    try:
        status = os.fstat(port)
        key = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
        with open("/proc/locks") as locks:
            process = next(line.split()[4] for line in locks if line.split()[1] == "FLOCK" and line.split()[5] == key)
        with open(f"/proc/{process}/comm") as name:
            return f" ({name.read().strip()}, process {process})"
    except (OSError, StopIteration, IndexError):
        return ""


class Host:
    """The host's end of a session. What is refused is only counted. A console has one host: the port is locked against
    others, as `sutura run` locks it (`flock`), before a byte is read."""

    def __init__(self, path):
        import fcntl, termios, tty  # noqa: E401 (not everywhere)

        try:
            self.port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            if error.errno == errno.EBUSY:
                raise Busy(f"{path} is in use by another program") from error
            raise
        try:
            fcntl.flock(self.port, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Keeps out programs that know nothing of the lock, too. On a pseudo-terminal it would outlive this process.
            if not os.path.realpath(path).startswith("/dev/pts/"):
                fcntl.ioctl(self.port, termios.TIOCEXCL)
            tty.setraw(self.port, termios.TCSANOW)
            termios.tcflush(self.port, termios.TCIFLUSH)
        except BlockingIOError as error:
            held = holder(self.port)
            os.close(self.port)
            raise Busy(f"{path} is in use by another program{held}") from error
        except BaseException:
            os.close(self.port)
            raise
        self.path = path
        self.session = self.sent = self.heard = self.lost = self.refused = 0
        self.console_time_us, self.line, self.ping_due = 0, bytearray(), 0.0

    def write(self, data, within=1.0):
        """All of it; a console that takes nothing for so long [s] is gone."""
        while data:
            if not select.select([], [self.port], [], within)[1]:
                raise ConnectionError(f"{self.path} takes no bytes")
            # A terminal may say that there is room and then have none.
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self.port, data):]

    def read(self, timeout):
        """What has come; waits at most `timeout` [s] for a first byte."""
        if not select.select([self.port], [], [], timeout)[0]:
            return b""
        try:
            data = os.read(self.port, 65536)
        except BlockingIOError:  # As in `write`.
            return b""
        except OSError as error:
            raise ConnectionError(f"the console on {self.path} is gone: {error.strerror}") from error
        if not data:
            raise ConnectionError(f"the console on {self.path} is gone: it closed its end of the line")
        return data

    def send(self, name, body, console_time_us=None):
        """One frame of the open session; for a contact with the console time of the state that it was computed for."""
        self.sent += 1
        if console_time_us is None:
            console_time_us = self.console_time_us
        self.write(encode(name, body, self.session, self.sent, console_time_us))

    def frames(self, timeout):
        """What is right of what came: name, body, console time; waits at most `timeout` [s] for bytes."""
        if self.session and time.monotonic() >= self.ping_due:
            self.send("Ping", {"host_us": time.monotonic_ns() // 1000})
            self.ping_due = time.monotonic() + 0.1
        self.line += self.read(timeout)
        while b"\0" in self.line:
            frame, _, self.line = self.line.partition(b"\0")
            if not frame:
                continue
            try:
                name, body, session, sequence, console_time_us = decode(bytes(frame))
                if name != "Hello":
                    ahead = (sequence - self.heard) % (1 << 32)
                    if session == 0 or session != self.session or not 0 < ahead < 1 << 31:
                        raise Refused("another session, or not newer")
                    self.lost, self.heard = self.lost + ahead - 1, sequence
            except Refused:
                self.refused += 1
                continue
            if name == "State":
                self.console_time_us = console_time_us
            yield name, body, console_time_us

    def open(self, within=3.0):
        """Asks for a session until the console gives one; the console's Hello."""
        deadline, said = time.monotonic() + within, "nothing came"
        while time.monotonic() < deadline:
            nonce = int.from_bytes(os.urandom(4), "little")
            # A delimiter first: it ends half a frame that an earlier host may have left on the line.
            self.write(b"\0" + encode("Hello", {
                "schema_hash": SCHEMA_HASH, "nonce": nonce, "session": 0, "tick_hz": TICK_HZ,
                "max_frame": MAX_FRAME, "simulated": False, "device_name": "", "refusal": "None"}))
            ask_again = time.monotonic() + 0.4
            while time.monotonic() < ask_again:
                for name, body, _ in self.frames(0.05):
                    if name == "Hello" and body["nonce"] == nonce and body["session"]:
                        self.session, self.sent, self.heard = body["session"], 0, 0
                        return body
                    said = f"refused: {body['refusal']}" if name == "Hello" else said
        raise ConnectionError(f"no session within {within} s ({said})")

    def close(self):
        try:
            self.send("Command", "Disarm")
        finally:
            os.close(self.port)


if __name__ == "__main__":
    for line in filter(lambda line: line.strip() and line[0] != "#", sys.stdin):
        shown = decode(bytes.fromhex(line.split()[-1]).rstrip(b"\0"))
        print(json.dumps(dict(zip(("message", "body", "session", "sequence", "console_time_us"), shown))))
