//! Cycles that a tick of the bench image would take on a chip, estimated: QEMU tells which blocks of instructions run, in order, and
//! what each of them costs is from the manuals. Entry point: [`estimate`].
//!
//! Instructions: Cortex-M4 technical reference manual (ARM 100166, r0p1), 3.3 and 7.2.3. Flash: RM0090, 3.5.2 (ST's "ART accelerator"): lines
//! of 16 bytes, 64 of them cached for instructions and 8 for literals, least recently used first, and the next line prefetched. RAM has
//! no wait states. Left out: constants in flash that are not literals, and whatever else uses the bus.

use crate::run::root;
use crate::setup::QEMU;
use crate::toolchain::TARGET;
use anyhow::{Context, Result, bail};
use object::{Object, ObjectSection, ObjectSymbol};
use serde::Serialize;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

/// Wait states of the flash at 168 MHz and more than 2.7 V (RM0090, table 10).
const WAIT_STATES: u32 = 5;
/// Refill of the pipeline after a branch that is taken: 1 to 3 cycles, by alignment and width of what is there.
const REFILL: u32 = 2;
/// Division takes 2 to 12 cycles, by how many bits differ.
const DIVIDE: u32 = 7;
/// Bytes of a line of flash, and lines that are kept.
const LINE: u32 = 16;
const CODE_LINES: usize = 64;
const LITERAL_LINES: usize = 8;

/// What the bench image counts of nothing before the first tick.
const EMPTY: usize = 8;
/// Ticks that are looked at: from when the console renders on.
const TICKS: std::ops::Range<usize> = 3..103;

/// An instruction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Instruction {
    /// Bytes.
    length: u32,
    /// If it goes on with the next one.
    cycles: u32,
    /// It may go elsewhere, and costs so much more then.
    branches: bool,
    /// A load or store of one register, whose address phase overlaps that of a neighbour.
    single: bool,
    load: bool,
    /// Where its literal is.
    literal: Option<u32>,
    /// Arithmetic whose result is in this register a cycle later.
    result: Option<u8>,
    /// Registers of the floating-point unit that it reads.
    reads: [Option<u8>; 3],
}

/// What was run, or the most expensive tick of a kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Estimate {
    /// Instructions.
    pub instructions: u64,
    /// Cycles.
    pub cycles: u64,
    /// Of those: waiting for the flash,
    pub flash: u64,
    /// and for the pipeline to fill after branches.
    pub branches: u64,
}

impl Estimate {
    fn since(self, begin: Estimate) -> Estimate {
        Estimate {
            instructions: self.instructions - begin.instructions,
            cycles: self.cycles - begin.cycles,
            flash: self.flash - begin.flash,
            branches: self.branches - begin.branches,
        }
    }
}

/// Reads the instruction at an address (ARMv7-M Architecture Reference Manual, A5 and A6).
fn decode(code: &[u8], base: u32, at: u32) -> Option<Instruction> {
    let half = |at: u32| {
        let from = at.checked_sub(base)? as usize;
        let bytes = code.get(from..from + 2)?;
        Some(u32::from(u16::from_le_bytes([bytes[0], bytes[1]])))
    };
    let first = half(at)?;
    if first >> 11 < 0b11101 {
        Some(short(first, at))
    } else {
        Some(long(first, half(at + 2)?, at))
    }
}

fn plain(length: u32, cycles: u32) -> Instruction {
    Instruction {
        length,
        cycles,
        ..Instruction::default()
    }
}

fn load(length: u32, literal: Option<u32>) -> Instruction {
    Instruction {
        single: true,
        load: true,
        literal,
        ..plain(length, 2)
    }
}

fn store(length: u32) -> Instruction {
    Instruction {
        single: true,
        ..plain(length, 1)
    }
}

fn branch(length: u32, cycles: u32) -> Instruction {
    Instruction {
        branches: true,
        ..plain(length, cycles)
    }
}

/// Instructions of 16 bits.
fn short(code: u32, at: u32) -> Instruction {
    let list = (code & 0xFF).count_ones();
    match code >> 8 {
        0x44..=0x46 if code & 0x87 == 0x87 => branch(2, 1),
        0x47 => branch(2, 1),
        0x48..=0x4F => load(2, Some(((at + 4) & !3) + 4 * (code & 0xFF))),
        // Offsets in registers: stores of a word, half, byte; then loads.
        0x50..=0x55 => store(2),
        0x56..=0x5F => load(2, None),
        0x60..=0x67 | 0x70..=0x77 | 0x80..=0x87 | 0x90..=0x97 => store(2),
        0x68..=0x6F | 0x78..=0x7F | 0x88..=0x8F | 0x98..=0x9F => load(2, None),
        0xB4 | 0xB5 => plain(2, 1 + list + (code >> 8 & 1)),
        0xBC => plain(2, 1 + list),
        0xBD => branch(2, 2 + list),
        0xB1 | 0xB3 | 0xB9 | 0xBB => branch(2, 1),
        0xC0..=0xCF => plain(2, 1 + list),
        0xD0..=0xDD | 0xE0..=0xE7 => branch(2, 1),
        _ => plain(2, 1),
    }
}

/// Instructions of 32 bits.
fn long(first: u32, second: u32, at: u32) -> Instruction {
    let list = second.count_ones();
    let literal = |offset: u32, up: bool| {
        let from = (at + 4) & !3;
        Some(if up {
            from.wrapping_add(offset)
        } else {
            from.wrapping_sub(offset)
        })
    };
    match first >> 9 {
        // Multiples, pairs, table branches.
        0b1110100 if first & 1 << 6 == 0 && second & 1 << 15 != 0 && first & 1 << 4 != 0 => {
            branch(4, 1 + list)
        }
        0b1110100 if first & 1 << 6 == 0 => plain(4, 1 + list),
        0b1110100 if first & 0xFFF0 == 0xE8D0 && second >> 5 == 0b11110000000 => branch(4, 2),
        0b1110100 => plain(4, 3),
        0b1110110 | 0b1110111 => float(first, second, literal),
        // Branches and calls.
        0b1111000..=0b1111011 if second & 1 << 15 != 0 => {
            let other = second >> 12 & 0b101 == 0 && first >> 7 & 7 == 7;
            if other { plain(4, 1) } else { branch(4, 1) }
        }
        0b1111100 if first & 1 << 4 != 0 => {
            let counts = first & 0xF == 15;
            let offset = second & 0xFFF;
            load(
                4,
                counts
                    .then(|| literal(offset, first & 1 << 7 != 0))
                    .flatten(),
            )
        }
        0b1111100 => store(4),
        // Long multiplications, divisions.
        0b1111101 if first >> 7 & 3 == 3 && first >> 4 & 0b101 == 1 => plain(4, DIVIDE),
        _ => plain(4, 1),
    }
}

/// The floating-point unit's.
fn float(first: u32, second: u32, literal: impl Fn(u32, bool) -> Option<u32>) -> Instruction {
    let register = |high: u32, low: u32| Some((high << 1 | low) as u8);
    let d = register(second >> 12 & 15, first >> 6 & 1);
    let n = register(first & 15, second >> 7 & 1);
    let m = register(second & 15, second >> 5 & 1);
    if second >> 9 & 7 != 0b101 {
        return plain(4, 1);
    }
    if first >> 8 & 0xF == 0b1110 && second & 1 << 4 == 0 {
        // Arithmetic: opc1 with its middle bit left out.
        let operation = (first >> 7 & 1, first >> 4 & 3);
        let arithmetic = |cycles, reads| Instruction {
            result: d,
            reads,
            ..plain(4, cycles)
        };
        return match operation {
            (0, 0 | 1) | (1, 1 | 2) => arithmetic(3, [d, n, m]),
            (0, _) => arithmetic(1, [n, m, None]),
            (1, 0) => arithmetic(14, [n, m, None]),
            _ if second & 1 << 6 == 0 => plain(4, 1),
            // Square root.
            _ if first & 15 == 1 && second & 1 << 7 != 0 => arithmetic(14, [m, None, None]),
            // Moves, signs.
            _ if first & 15 <= 1 => Instruction {
                reads: [m, None, None],
                ..plain(4, 1)
            },
            // Comparisons.
            _ if first & 15 <= 5 => Instruction {
                reads: [d, m, None],
                ..plain(4, 1)
            },
            _ => arithmetic(1, [m, None, None]),
        };
    }
    if first >> 8 & 0xF == 0b1110 {
        // Between the units, and the flags.
        return Instruction {
            reads: [(first & 1 << 4 != 0).then_some(n).flatten(), None, None],
            ..plain(4, 1)
        };
    }
    let words = second & 0xFF;
    match first >> 4 & 0x1F {
        // One register with an offset.
        way if way & 0b10010 == 0b10000 && way & 1 != 0 => {
            let counts = first & 15 == 15;
            load(
                4,
                counts
                    .then(|| literal(4 * words, first & 1 << 7 != 0))
                    .flatten(),
            )
        }
        way if way & 0b10010 == 0b10000 => Instruction {
            reads: [d, None, None],
            ..plain(4, 2)
        },
        0b00100 | 0b00101 => plain(4, 2),
        _ => plain(4, 1 + words),
    }
}

/// Lines that are kept, the newest last.
#[derive(Debug, Default)]
struct Kept(VecDeque<u32>);

impl Kept {
    /// Whether a line was there; it is the newest now.
    fn has(&mut self, line: u32, most: usize) -> bool {
        let place = self.0.iter().position(|kept| *kept == line);
        if let Some(place) = place {
            self.0.remove(place);
        } else if self.0.len() >= most {
            self.0.pop_front();
        }
        self.0.push_back(line);
        place.is_some()
    }
}

/// A core that runs one instruction after the other.
#[derive(Debug, Default)]
struct Core {
    code: Kept,
    literals: Kept,
    /// Line of the newest instruction, and cycles since it was entered.
    line: u32,
    since: u32,
    before: Instruction,
    sum: Estimate,
}

impl Core {
    fn run(&mut self, at: u32, instruction: &Instruction, taken: bool) {
        let mut cycles = instruction.cycles;
        // A load or store next to another overlaps it.
        if instruction.single && self.before.single && instruction.load {
            cycles -= 1;
        }
        let awaited = self.before.result;
        cycles += u32::from(awaited.is_some() && instruction.reads.contains(&awaited));
        if instruction.branches && taken {
            cycles += REFILL;
            self.sum.branches += u64::from(REFILL);
        }
        let mut waits = 0;
        for line in [at / LINE, (at + instruction.length - 1) / LINE] {
            if line != self.line {
                let next = line == self.line + 1;
                if !self.code.has(line, CODE_LINES) {
                    // The next one is on its way since this one was there.
                    let done = if next { self.since.min(WAIT_STATES) } else { 0 };
                    waits += WAIT_STATES - done;
                }
                self.line = line;
                self.since = 0;
            }
        }
        if let Some(literal) = instruction.literal
            && !self.literals.has(literal / LINE, LITERAL_LINES)
        {
            cycles += WAIT_STATES;
            self.sum.flash += u64::from(WAIT_STATES);
        }
        self.since += cycles;
        self.before = *instruction;
        self.sum.instructions += 1;
        self.sum.cycles += u64::from(cycles + waits);
        self.sum.flash += u64::from(waits);
    }
}

/// Blocks of the emulator end at a branch, or at the end of such a page.
const PAGE: u32 = 1024;

/// The image's code, and the instructions of it that have been read.
struct Code {
    bytes: Vec<u8>,
    base: u32,
    known: HashMap<u32, Instruction>,
    /// Functions around what is looked at.
    begin: u32,
    end: u32,
}

impl Code {
    fn read() -> Result<Code> {
        let path = image();
        let bytes =
            std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let file = object::File::parse(&*bytes)?;
        let text = file
            .section_by_name(".text")
            .context("the bench image has no code")?;
        let place = |function: &str| {
            let named = |symbol: &object::Symbol<'_, '_>| {
                let name = symbol.name().unwrap_or_default();
                format!("{:#}", rustc_demangle::demangle(name))
                    == format!("sutura_bench::{function}")
            };
            let symbol = file.symbols().find(named);
            let symbol = symbol.with_context(|| format!("the bench image has no `{function}`"))?;
            // Bit 0 says that it is Thumb.
            anyhow::Ok(symbol.address() as u32 & !1)
        };
        Ok(Code {
            base: text.address() as u32,
            begin: place("mark_begin")?,
            end: place("mark_end")?,
            bytes: text.data()?.to_vec(),
            known: HashMap::new(),
        })
    }

    fn at(&mut self, at: u32) -> Result<Instruction> {
        if let Some(known) = self.known.get(&at) {
            return Ok(*known);
        }
        let read = decode(&self.bytes, self.base, at);
        let read = read.with_context(|| format!("no code at {at:#010x}"))?;
        self.known.insert(at, read);
        Ok(read)
    }

    /// Has the core do a block, after which another begins at `next`.
    fn run(&mut self, core: &mut Core, block: u32, next: u32) -> Result<()> {
        let mut at = block;
        loop {
            let instruction = self.at(at)?;
            let after = at + instruction.length;
            core.run(at, &instruction, next != after);
            let page_ends = after / PAGE != block / PAGE;
            if instruction.branches || page_ends || after - block > PAGE {
                return Ok(());
            }
            at = after;
        }
    }
}

fn image() -> std::path::PathBuf {
    root()
        .join("firmware/target")
        .join(TARGET)
        .join("release/sutura-bench")
}

/// The most expensive tick of a case, and the most expensive one that changes the model, which every tenth does.
///
/// # Errors
/// If the emulator does not run, or does something that nobody can follow.
pub fn estimate(case: &str) -> Result<[Estimate; 2]> {
    let mut code = Code::read()?;
    let words = format!("enable=on,target=native,arg=bench,arg=only,arg={case}");
    let mut child = Command::new(QEMU)
        .args([
            "-M",
            "netduinoplus2",
            "-nographic",
            "-icount",
            "shift=3,sleep=off",
        ])
        .args([
            "-d",
            "exec,nochain",
            "-D",
            "/dev/stdout",
            "-semihosting-config",
        ])
        .arg(words)
        .arg("-kernel")
        .arg(image())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .with_context(|| format!("`{QEMU}` does not start; `cargo xtask setup` installs it"))?;
    let stdout = child.stdout.take().context("no output")?;
    let found = follow(&mut code, BufReader::with_capacity(1 << 20, stdout));
    // It would go on to the end of all cases.
    child.kill()?;
    child.wait()?;
    found.with_context(|| format!("the case `{case}`"))
}

/// Follows the blocks that the emulator tells of, one a line.
fn follow(code: &mut Code, mut lines: impl BufRead) -> Result<[Estimate; 2]> {
    let mut core = Core::default();
    let (mut most, mut marks) = ([Estimate::default(); 2], 0_usize);
    let (mut before, mut began) = (None, None);
    let mut line = Vec::new();
    loop {
        line.clear();
        if lines.read_until(b'\n', &mut line)? == 0 {
            bail!("the bench image ended after {marks} marks");
        }
        let Some(block) = block_of(&line) else {
            continue;
        };
        if let Some(before) = before.filter(|_| began.is_some() || marks > 0) {
            code.run(&mut core, before, block)?;
        }
        before = Some(block);
        if block == code.begin {
            began = Some(core.sum);
        } else if block == code.end
            && let Some(begin) = began.take()
        {
            if let Some(tick) = marks.checked_sub(EMPTY).filter(|tick| TICKS.contains(tick)) {
                // Every tenth changes the model.
                let kind = &mut most[usize::from(tick % 10 == 5)];
                let tick = core.sum.since(begin);
                if tick.cycles > kind.cycles {
                    *kind = tick;
                }
            }
            marks += 1;
            if marks == EMPTY + TICKS.end {
                return Ok(most);
            }
        }
    }
}

/// `Trace 0: 0x7f16.. [00800400/08004ece/00000010/ff020200] name`: the block's address.
fn block_of(line: &[u8]) -> Option<u32> {
    let line = std::str::from_utf8(line).ok()?.strip_prefix("Trace ")?;
    let address = line.split_once('[')?.1.split('/').nth(1)?;
    u32::from_str_radix(address, 16).ok()
}

/// Cases whose ticks are followed.
const CASES: [&str; 6] = [
    "tick_tangent_cartesian",
    "tick_tangent_serial_arm",
    "tick_rows24_cartesian",
    "tick_rows24_serial_arm",
    "tick_rows24_cones_cartesian",
    "tick_rows24_cones_serial_arm",
];

/// Estimates of all cases, by name; those that change the model besides by the names that they are counted under.
///
/// # Errors
/// See [`estimate`].
pub fn all() -> Result<BTreeMap<String, Estimate>> {
    eprintln!("following ticks under QEMU");
    let mut all = BTreeMap::new();
    for case in CASES {
        let [plain, swap] = estimate(case)?;
        let swap_name = ["_cartesian", "_serial_arm"]
            .into_iter()
            .find_map(|device| {
                let stem = case.strip_suffix(device)?;
                Some(format!("{stem}_with_swap{device}"))
            });
        all.insert(case.to_owned(), plain);
        all.insert(swap_name.unwrap_or_default(), swap);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodings as an assembler (LLVM 14) gives them.
    fn read(halves: &[u16]) -> Instruction {
        let bytes: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        decode(&bytes, 0x0800_0000, 0x0800_0000).expect("an instruction")
    }

    #[test]
    fn instructions_cost_what_the_manual_says() {
        for (halves, length, cycles, branches) in [
            // adds r1, r5, r2; mul r0, r1; ldr r1, [r0, #64]; str r3, [r1, #16].
            (&[0x18A9][..], 2, 1, false),
            (&[0x4348], 2, 1, false),
            (&[0x6C01], 2, 2, false),
            (&[0x610B], 2, 1, false),
            // push {r4, r5, r7, lr}; pop {r4, r5, r7, pc}; bx lr; b.n; beq.n; cbz r0.
            (&[0xB5B0], 2, 5, false),
            (&[0xBDB0], 2, 5, true),
            (&[0x4770], 2, 1, true),
            (&[0xE09E], 2, 1, true),
            (&[0xD0FE], 2, 1, true),
            (&[0xB100], 2, 1, true),
            // bl; sdiv r0, r1, r2; umull r0, r1, r2, r3; ldrd r3, r4, [r0]; ldr.w r1, [r8, #24]; mov.w r3, #524288.
            (&[0xF000, 0xF800], 4, 1, true),
            (&[0xFB91, 0xF0F2], 4, DIVIDE, false),
            (&[0xFBA2, 0x0103], 4, 1, false),
            (&[0xE9D0, 0x3400], 4, 3, false),
            (&[0xF8D8, 0x1018], 4, 2, false),
            (&[0xF44F, 0x2300], 4, 1, false),
            // stmdb sp!, {r4-r11, lr}; ldmia.w sp!, {r4-r11, pc}.
            (&[0xE92D, 0x4FF0], 4, 10, false),
            (&[0xE8BD, 0x8FF0], 4, 10, true),
            // vadd.f32 s0, s1, s2; vmul; vmla; vfma; vdiv; vsqrt; vcmp; vmov s0, s1; vldr s0, [r0]; vstr; vpush {d8-d11}.
            (&[0xEE30, 0x0A81], 4, 1, false),
            (&[0xEE20, 0x0A81], 4, 1, false),
            (&[0xEE00, 0x0A81], 4, 3, false),
            (&[0xEEA0, 0x0A81], 4, 3, false),
            (&[0xEE80, 0x0A81], 4, 14, false),
            (&[0xEEB1, 0x0AE0], 4, 14, false),
            (&[0xEEB4, 0x0A60], 4, 1, false),
            (&[0xEEB0, 0x0A60], 4, 1, false),
            (&[0xED90, 0x0A00], 4, 2, false),
            (&[0xED80, 0x0A00], 4, 2, false),
            (&[0xED2D, 0x8B08], 4, 9, false),
        ] {
            let found = read(halves);
            let text = format!("{halves:04x?}");
            assert_eq!(
                (found.length, found.cycles, found.branches),
                (length, cycles, branches),
                "{text}"
            );
        }
    }

    #[test]
    fn a_result_that_is_needed_at_once_is_waited_for() {
        let mut core = Core::default();
        let sum = read(&[0xEE30, 0x0A81]);
        let product = read(&[0xEE20, 0x0A81]);
        // s0 = s1 + s2, s0 = s1 * s2: not needed. Then s3 = s0 * s0.
        let square = read(&[0xEE60, 0x1A00]);
        for (at, instruction) in [sum, product, square].iter().enumerate() {
            core.run(4 * at as u32, instruction, false);
        }
        assert_eq!(core.sum.cycles, 1 + 1 + 2);
    }

    /// A straight line waits for each line of flash but for what of it is on its way; a loop that fits does not.
    #[test]
    fn flash_is_waited_for_once() {
        let mut core = Core::default();
        let add = plain(4, 1);
        for at in (LINE..5 * LINE).step_by(4) {
            core.run(at, &add, false);
        }
        // The first line in full, the others less the four cycles of the one before.
        let waits = 5 + 3 * u64::from(WAIT_STATES - 4);
        assert_eq!((core.sum.cycles, core.sum.flash), (16 + waits, waits));
        let before = core.sum;
        let back = branch(4, 1);
        core.run(5 * LINE - 4, &back, true);
        for at in (LINE..5 * LINE).step_by(4) {
            core.run(at, &add, false);
        }
        let loop_again = core.sum.since(before);
        assert_eq!(loop_again.cycles, 1 + u64::from(REFILL) + 16);
        assert_eq!(
            (loop_again.flash, loop_again.branches),
            (0, u64::from(REFILL))
        );
    }

    #[test]
    fn blocks_are_found_in_what_the_emulator_logs() {
        let line = b"Trace 0: 0x7f165c18b680 [00800400/08004ed6/00000010/ff020200] name\n";
        assert_eq!(block_of(line), Some(0x0800_4ED6));
        assert_eq!(
            block_of(b"{\"name\":\"contact_swap\",\"instructions\":14}\n"),
            None
        );
    }
}
