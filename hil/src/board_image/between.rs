//! What an image does between two accesses to its devices: instructions of ARMv7-M that touch no memory, done in the processor's place.
//!
//! Entry point: [`go_past`]. Encodings: ARMv7-M Architecture Reference Manual, A5.2 and A5.3, and A7.7 of each instruction. Not here:
//! IT blocks, calls, special registers, floating point, signed and saturating arithmetic; the processor does those itself, as it does every
//! instruction that no device is near. `BoardImage::compare` has the processor say of each what it does.

use super::connection::{PC, STATUS};

/// Flags of the status word: negative, zero, carry, overflow.
const N: u32 = 1 << 31;
const Z: u32 = 1 << 30;
const C: u32 = 1 << 29;
const V: u32 = 1 << 28;
/// The rest of an IT block.
const IT: u32 = 0x0600_FC00;
/// Stack pointer and program counter.
const SP: u32 = 13;
const COUNTER: u32 = 15;

/// Does an instruction, if it is one of those and no IT block decides about it. Whether it was; if not nothing has changed.
/// `registers`: r0 to r15 and the status word.
pub fn go_past(code: [u16; 2], registers: &mut [u32]) -> bool {
    let [first, second] = code.map(u32::from);
    if is_in_it(registers) {
        return false;
    }
    let mut core = Core(registers);
    if first >> 11 < 0b11101 {
        core.short(first)
    } else {
        core.long(first, second)
    }
    .is_some()
}

/// Whether an IT block decides about the next instruction.
pub fn is_in_it(registers: &[u32]) -> bool {
    registers[STATUS] & IT != 0
}

struct Core<'a>(&'a mut [u32]);

/// A number, and the carry that comes of it if any does.
type Shifted = (u32, Option<bool>);

impl Core<'_> {
    /// Instructions of 16 bits. None: another one.
    fn short(&mut self, code: u32) -> Option<()> {
        let low = |at: u32| code >> at & 7;
        let byte = code & 0xFF;
        match code >> 11 {
            0b00000..=0b00010 => {
                let shifted = self.shift(code >> 11, self.r(low(3)), code >> 6 & 31);
                self.logic(low(0), shifted, true);
            }
            0b00011 => {
                let by = match code >> 10 & 1 {
                    0 => self.r(low(6)),
                    _ => low(6),
                };
                let (by, carry) = if code >> 9 & 1 == 0 {
                    (by, 0)
                } else {
                    (!by, 1)
                };
                let sum = self.sum(self.r(low(3)), by, carry, true);
                self.set(low(0), sum);
            }
            0b00100 => self.logic(low(8), (byte, None), true),
            0b00101 => {
                self.sum(self.r(low(8)), !byte, 1, true);
            }
            0b00110 | 0b00111 => {
                let (by, carry) = if code >> 11 & 1 == 0 {
                    (byte, 0)
                } else {
                    (!byte, 1)
                };
                let sum = self.sum(self.r(low(8)), by, carry, true);
                self.set(low(8), sum);
            }
            0b01000 if code >> 10 & 1 == 0 => self.of_registers(code >> 6 & 15, low(3), low(0))?,
            0b01000 => {
                let (rd, rm) = (code >> 4 & 8 | low(0), code >> 3 & 15);
                if rd == COUNTER || rm == COUNTER || rd == SP && code >> 8 & 3 != 1 {
                    return None;
                }
                match code >> 8 & 3 {
                    0 => self.set(rd, self.r(rd).wrapping_add(self.r(rm))),
                    1 => {
                        self.sum(self.r(rd), !self.r(rm), 1, true);
                    }
                    2 => self.set(rd, self.r(rm)),
                    _ => return None,
                }
            }
            0b10101 => self.set(low(8), self.r(SP).wrapping_add(4 * byte)),
            0b10110 | 0b10111 if code & 0xF500 == 0xB100 => {
                let is_zero = self.r(low(0)) == 0;
                let offset = code >> 3 & 0x40 | code >> 2 & 0x3E;
                let jumps = is_zero == (code >> 11 & 1 == 0);
                self.go(if jumps { 4 + offset as i32 } else { 2 });
                return Some(());
            }
            0b10110 if code & 0xFF00 == 0xB200 => {
                let value = self.r(low(3));
                let value = match code >> 6 & 3 {
                    0 => value as i16 as u32,
                    1 => value as i8 as u32,
                    2 => value & 0xFFFF,
                    _ => value & 0xFF,
                };
                self.set(low(0), value);
            }
            0b10111 if code == 0xBF00 => {}
            0b11010 | 0b11011 if code >> 9 & 7 != 7 => {
                let jumps = holds(code >> 8 & 15, self.0[STATUS]);
                self.go(if jumps {
                    4 + 2 * i32::from(code as u8 as i8)
                } else {
                    2
                });
                return Some(());
            }
            0b11100 => {
                self.go(4 + ((code << 21) as i32 >> 20));
                return Some(());
            }
            _ => return None,
        }
        self.go(2);
        Some(())
    }

    /// Data processing of two low registers (A5.2.2).
    fn of_registers(&mut self, operation: u32, rm: u32, rd: u32) -> Option<()> {
        let (a, b) = (self.r(rd), self.r(rm));
        let carry = self.flag(C);
        match operation {
            0 => self.logic(rd, (a & b, None), true),
            1 => self.logic(rd, (a ^ b, None), true),
            2..=4 | 7 => {
                let kind = [0, 0, 0, 1, 2, 0, 0, 3][operation as usize];
                let shifted = shift_by(kind, a, b & 0xFF);
                self.logic(rd, shifted, true);
            }
            5 => {
                let sum = self.sum(a, b, carry, true);
                self.set(rd, sum);
            }
            6 => {
                let sum = self.sum(a, !b, carry, true);
                self.set(rd, sum);
            }
            8 => self.flags((a & b, None)),
            9 => {
                let sum = self.sum(!b, 0, 1, true);
                self.set(rd, sum);
            }
            10 => {
                self.sum(a, !b, 1, true);
            }
            11 => {
                self.sum(a, b, 0, true);
            }
            12 => self.logic(rd, (a | b, None), true),
            13 => self.logic(rd, (a.wrapping_mul(b), None), true),
            14 => self.logic(rd, (a & !b, None), true),
            _ => self.logic(rd, (!b, None), true),
        }
        Some(())
    }

    /// Instructions of 32 bits. None: another one.
    fn long(&mut self, first: u32, second: u32) -> Option<()> {
        let rd = second >> 8 & 15;
        match first >> 8 {
            0xF0..=0xF7 if second >> 15 == 1 => return self.branch(first, second),
            0xF0 | 0xF1 | 0xF4 | 0xF5 => {
                let imm = first >> 10 & 1;
                let constant = expand(imm << 11 | second >> 4 & 0x700 | second & 0xFF);
                self.data(
                    first >> 5 & 15,
                    first >> 4 & 1 == 1,
                    first & 15,
                    rd,
                    constant,
                )?;
            }
            0xF2 | 0xF3 | 0xF6 | 0xF7 => self.plain(first, second, rd)?,
            0xEA | 0xEB => {
                let amount = second >> 10 & 0x1C | second >> 6 & 3;
                let rm = second & 15;
                // Rotation with the carry.
                if !is_plain(rm) || second >> 4 & 3 == 3 && amount == 0 {
                    return None;
                }
                let operand = self.shift(second >> 4 & 3, self.r(rm), amount);
                self.data(
                    first >> 5 & 15,
                    first >> 4 & 1 == 1,
                    first & 15,
                    rd,
                    operand,
                )?;
            }
            0xFA if second & 0xF000 == 0xF000 => self.register_shift(first, second, rd)?,
            0xFB => self.product(first, second, rd)?,
            _ => return None,
        }
        self.go(4);
        Some(())
    }

    fn branch(&mut self, first: u32, second: u32) -> Option<()> {
        let sign = first >> 10 & 1;
        let [j1, j2] = [13, 11].map(|at| second >> at & 1);
        let far = (second & 0x7FF) << 1;
        let (jumps, offset) = match (second >> 14 & 1, second >> 12 & 1) {
            (0, 0) => {
                let condition = first >> 6 & 15;
                if condition >= 14 {
                    return None;
                }
                let offset = sign << 20 | j2 << 19 | j1 << 18 | (first & 0x3F) << 12 | far;
                let jumps = holds(condition, self.0[STATUS]);
                (jumps, (offset << 11) as i32 >> 11)
            }
            (0, 1) => {
                let [i1, i2] = [j1, j2].map(|j| 1 ^ j ^ sign);
                let offset = sign << 24 | i1 << 23 | i2 << 22 | (first & 0x3FF) << 12 | far;
                (true, (offset << 7) as i32 >> 7)
            }
            _ => return None,
        };
        self.go(if jumps { 4 + offset } else { 4 });
        Some(())
    }

    /// Data processing with a second operand that is there already (A5.3.1, A5.3.11).
    fn data(&mut self, op: u32, sets: bool, rn: u32, rd: u32, (b, carry): Shifted) -> Option<()> {
        let compares = rd == COUNTER && sets && matches!(op, 0 | 4 | 8 | 13);
        let moves = rn == COUNTER && matches!(op, 2 | 3);
        // Neither stack pointer nor counter, but where they mean something else; a comparison with the stack pointer is one.
        if !compares && !is_plain(rd) || !moves && rn == COUNTER {
            return None;
        }
        let a = if moves { 0 } else { self.r(rn) };
        let c = self.flag(C);
        let logic = match op {
            0 => Some(a & b),
            1 => Some(a & !b),
            2 => Some(a | b),
            3 => Some(a | !b),
            4 => Some(a ^ b),
            _ => None,
        };
        if let Some(value) = logic {
            if compares {
                self.flags((value, carry));
            } else {
                self.logic(rd, (value, carry), sets);
            }
            return Some(());
        }
        let (a, b, c) = match op {
            8 => (a, b, 0),
            10 => (a, b, c),
            11 => (a, !b, c),
            13 => (a, !b, 1),
            14 => (!a, b, 1),
            _ => return None,
        };
        let sum = self.sum(a, b, c, sets);
        if !compares {
            self.set(rd, sum);
        }
        Some(())
    }

    /// Constants as they are, and fields of bits (A5.3.3).
    fn plain(&mut self, first: u32, second: u32, rd: u32) -> Option<()> {
        let rn = first & 15;
        let twelve = (first >> 10 & 1) << 11 | second >> 4 & 0x700 | second & 0xFF;
        let lowest = second >> 10 & 0x1C | second >> 6 & 3;
        let field = second & 31;
        if !is_plain(rd) {
            return None;
        }
        let value = match first >> 4 & 31 {
            0b00000 if rn != COUNTER => self.r(rn).wrapping_add(twelve),
            0b01010 if rn != COUNTER => self.r(rn).wrapping_sub(twelve),
            0b00100 => rn << 12 | twelve,
            0b01100 => self.r(rd) & 0xFFFF | (rn << 12 | twelve) << 16,
            0b10100 | 0b11100 if is_plain(rn) && lowest + field < 32 => {
                let value = self.r(rn) << (31 - field - lowest);
                if first >> 7 & 1 == 0 {
                    (value as i32 >> (31 - field)) as u32
                } else {
                    value >> (31 - field)
                }
            }
            0b10110 if rn != SP => {
                let width = (field + 1).checked_sub(lowest).filter(|width| *width > 0)?;
                let mask = u32::MAX >> (32 - width) << lowest;
                let from = if rn == COUNTER {
                    0
                } else {
                    self.r(rn) << lowest
                };
                self.r(rd) & !mask | from & mask
            }
            _ => return None,
        };
        self.set(rd, value);
        Some(())
    }

    /// Shifts by a register, and bytes and halfwords made words (A5.3.12).
    fn register_shift(&mut self, first: u32, second: u32, rd: u32) -> Option<()> {
        let (rn, rm) = (first & 15, second & 15);
        if !is_plain(rd) || !is_plain(rm) {
            return None;
        }
        match (first >> 4 & 15, second >> 4 & 15) {
            (kind @ 0..8, 0) if is_plain(rn) => {
                let shifted = shift_by(kind >> 1, self.r(rn), self.r(rm) & 0xFF);
                self.logic(rd, shifted, kind & 1 == 1);
            }
            (kind @ (0 | 1 | 4 | 5), rotation @ 8..12) if rn == COUNTER => {
                let value = self.r(rm).rotate_right(8 * (rotation & 3));
                let value = match kind {
                    0 => value as i16 as u32,
                    1 => value & 0xFFFF,
                    4 => value as i8 as u32,
                    _ => value & 0xFF,
                };
                self.set(rd, value);
            }
            _ => return None,
        }
        Some(())
    }

    /// Products, and a quotient without sign (A5.3.16, A5.3.17).
    fn product(&mut self, first: u32, second: u32, rd: u32) -> Option<()> {
        let (rn, rm, ra) = (first & 15, second & 15, second >> 12);
        if ![rd, rn, rm].into_iter().all(is_plain) {
            return None;
        }
        let (a, b) = (self.r(rn), self.r(rm));
        match (first >> 4 & 15, second >> 4 & 15) {
            (0, 0) if ra == COUNTER => self.set(rd, a.wrapping_mul(b)),
            (0, 0) if is_plain(ra) => self.set(rd, a.wrapping_mul(b).wrapping_add(self.r(ra))),
            (0, 1) if is_plain(ra) => self.set(rd, self.r(ra).wrapping_sub(a.wrapping_mul(b))),
            (0xA, 0) if is_plain(ra) => {
                let product = u64::from(a) * u64::from(b);
                self.set(ra, product as u32);
                self.set(rd, (product >> 32) as u32);
            }
            (0xB, 0xF) if ra == COUNTER => self.set(rd, a.checked_div(b).unwrap_or(0)),
            _ => return None,
        }
        Some(())
    }

    fn r(&self, register: u32) -> u32 {
        self.0[register as usize]
    }

    fn set(&mut self, register: u32, value: u32) {
        self.0[register as usize] = value;
    }

    fn go(&mut self, by: i32) {
        self.0[PC] = self.0[PC].wrapping_add_signed(by);
    }

    fn flag(&self, flag: u32) -> u32 {
        u32::from(self.0[STATUS] & flag != 0)
    }

    fn put_flag(&mut self, flag: u32, on: bool) {
        let status = self.0[STATUS] & !flag;
        self.0[STATUS] = status | if on { flag } else { 0 };
    }

    /// Flags of a number that no sum has made.
    fn flags(&mut self, (value, carry): Shifted) {
        self.put_flag(N, value & N != 0);
        self.put_flag(Z, value == 0);
        if let Some(carry) = carry {
            self.put_flag(C, carry);
        }
    }

    fn logic(&mut self, rd: u32, shifted: Shifted, sets: bool) {
        self.set(rd, shifted.0);
        if sets {
            self.flags(shifted);
        }
    }

    /// `AddWithCarry` (A2.2.1).
    fn sum(&mut self, a: u32, b: u32, carry: u32, sets: bool) -> u32 {
        let wide = u64::from(a) + u64::from(b) + u64::from(carry);
        let sum = wide as u32;
        if sets {
            self.flags((sum, Some(wide >> 32 != 0)));
            self.put_flag(V, (a ^ sum) & (b ^ sum) & N != 0);
        }
        sum
    }

    /// Shift by a constant (A7.4.2): left, right, right with the sign, around.
    fn shift(&self, kind: u32, value: u32, amount: u32) -> Shifted {
        match (kind, amount) {
            (0, 0) => (value, None),
            (1 | 2, 0) => shift_by(kind, value, 32),
            _ => shift_by(kind, value, amount),
        }
    }
}

/// Neither stack pointer nor program counter.
fn is_plain(register: u32) -> bool {
    register != SP && register != COUNTER
}

/// Shift by 0 to 255 (A2.2.1).
fn shift_by(kind: u32, value: u32, amount: u32) -> Shifted {
    let bit = |at: u32| Some(value >> at & 1 == 1);
    match (kind, amount) {
        (_, 0) => (value, None),
        (0, 1..=31) => (value << amount, bit(32 - amount)),
        (0, 32) => (0, bit(0)),
        (1, 1..=31) => (value >> amount, bit(amount - 1)),
        (1, 32) => (0, bit(31)),
        (0 | 1, _) => (0, Some(false)),
        (2, 1..=31) => ((value as i32 >> amount) as u32, bit(amount - 1)),
        (2, _) => ((value as i32 >> 31) as u32, bit(31)),
        _ => {
            let turned = value.rotate_right(amount & 31);
            (turned, Some(turned & N != 0))
        }
    }
}

/// `ThumbExpandImm_C` (A5.3.2).
fn expand(constant: u32) -> Shifted {
    let byte = constant & 0xFF;
    match constant >> 8 {
        0 => (byte, None),
        1 => (byte << 16 | byte, None),
        2 => (byte << 24 | byte << 8, None),
        3 => (byte * 0x0101_0101, None),
        _ => shift_by(3, 0x80 | constant & 0x7F, constant >> 7),
    }
}

/// Whether a condition (A7.3) holds.
fn holds(condition: u32, status: u32) -> bool {
    let is_set = |flag| status & flag != 0;
    let holds = match condition >> 1 {
        0 => is_set(Z),
        1 => is_set(C),
        2 => is_set(N),
        3 => is_set(V),
        4 => is_set(C) && !is_set(Z),
        5 => is_set(N) == is_set(V),
        6 => !is_set(Z) && is_set(N) == is_set(V),
        _ => return true,
    };
    holds != (condition & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Thumb state, and a carry.
    const BEFORE: u32 = 0x0100_0000 | C;

    fn registers() -> [u32; 17] {
        let mut registers = [0; 17];
        registers[..8].copy_from_slice(&[7, 3, 0x80, 0x10, u32::MAX, N, 0x1_2345, 0]);
        registers[9] = 0x1100;
        registers[12] = 0x0ABC_DEF0;
        registers[13] = 0x2000_1000;
        registers[STATUS] = BEFORE;
        registers
    }

    /// Encodings as an assembler (LLVM 14) gives them; what each leaves in a register, and flags.
    #[test]
    fn instructions_do_what_the_manual_says() {
        let same = C;
        for (text, code, register, value, flags) in [
            ("adds r1, r5, r2", [0x18A9, 0], 1, 0x8000_0080, N),
            ("subs r0, r0, r1", [0x1A40, 0], 0, 4, C),
            ("adcs r3, r4", [0x4163, 0], 3, 0x10, C),
            ("movs r2, #0", [0x2200, 0], 2, 0, Z | C),
            ("lsls r0, r6, #19", [0x04F0, 0], 0, 0x1A28_0000, C),
            ("asrs r1, r2, #31", [0x17D1, 0], 1, 0, Z),
            ("mvns r1, r5", [0x43E9, 0], 1, 0x7FFF_FFFF, C),
            ("muls r1, r3, r1", [0x4359, 0], 1, 0x30, C),
            ("cmp r1, #7", [0x2907, 0], 1, 3, N),
            ("cmp.w r6, #-1", [0xF1B6, 0x3FFF], 6, 0x1_2345, 0),
            ("tst.w r5, #12", [0xF015, 0x0F0C], 5, N, Z | C),
            ("add r7, sp, #12", [0xAF03, 0], 7, 0x2000_100C, same),
            ("mov r11, r4", [0x46A3, 0], 11, u32::MAX, same),
            ("uxth r3, r1", [0xB28B, 0], 3, 3, same),
            ("bic r2, r0, #0xff000000", [0xF020, 0x427F], 2, 7, same),
            ("mov.w r3, #1000", [0xF44F, 0x737A], 3, 1000, same),
            (
                "mvn r2, #0x80000000",
                [0xF06F, 0x4200],
                2,
                0x7FFF_FFFF,
                same,
            ),
            ("movw r1, #57368", [0xF24E, 0x0118], 1, 57_368, same),
            ("movt r1, #57344", [0xF2CE, 0x0100], 1, 0xE000_0003, same),
            (
                "sub.w r2, r0, #98304",
                [0xF5A0, 0x32C0],
                2,
                0xFFFE_8007,
                same,
            ),
            ("adc r10, r4, #0", [0xF144, 0x0A00], 10, 0, same),
            ("umull r6, r0, r2, r0", [0xFBA2, 0x6000], 6, 0x380, same),
            ("mls r1, r2, r0, r1", [0xFB02, 0x1110], 1, 0xFFFF_FC83, same),
            ("udiv r2, r1, r0", [0xFBB1, 0xF2F0], 2, 0, same),
            ("ubfx r12, r12, #4, #11", [0xF3CC, 0x1C0A], 12, 0x5EF, same),
            ("bfi r3, r4, #8, #4", [0xF364, 0x230B], 3, 0xF10, same),
            (
                "add.w r1, r1, r2, lsl #5",
                [0xEB01, 0x1142],
                1,
                0x1003,
                same,
            ),
            ("rsb r2, r0, r0, lsl #3", [0xEBC0, 0x02C0], 2, 49, same),
            ("lsl.w r9, r2, r0", [0xFA02, 0xF900], 9, 0x4000, same),
            ("uxtb.w r1, r9", [0xFA5F, 0xF189], 1, 0, same),
        ] {
            let mut after = registers();
            assert!(go_past(code, &mut after), "{text}");
            let length = if code[1] == 0 { 2 } else { 4 };
            assert_eq!(after[PC], length, "{text}");
            assert_eq!(after[register], value, "{text}: {:#x}", after[register]);
            assert_eq!(after[STATUS], BEFORE & !C | flags, "{text}");
        }
    }

    #[test]
    fn what_is_left_to_the_processor_changes_nothing() {
        // svc 0; it ne; bx lr; push {r7, lr}; ldr r0, [pc, #28]; mrs r0, basepri; bl; isb; vldr s2, [r1]; ldrd r3, r4, [r0]; mov sp, r4;
        // add pc, r0; ldmia.
        for code in [
            [0xDF00, 0],
            [0xBF18, 0],
            [0x4770, 0],
            [0xB580, 0],
            [0x4807, 0],
            [0xF3EF, 0x8011],
            [0xF000, 0xF800],
            [0xF3BF, 0x8F6F],
            [0xED91, 0x1A00],
            [0xE9D0, 0x3400],
            [0x46A5, 0],
            [0x4487, 0],
            [0xCA6C, 0],
        ] {
            let mut after = registers();
            assert!(!go_past(code, &mut after), "{code:04x?}");
            assert_eq!(after, registers(), "{code:04x?}");
        }
        // cmp r10, r2 in an IT block.
        let mut within = registers();
        within[STATUS] |= 0x0C << 8;
        assert!(!go_past([0x4592, 0], &mut within));
    }

    /// The loop that empties the USB core's FIFO.
    #[test]
    fn branches_are_taken_as_flags_say() {
        let mut registers = registers();
        let mut go = |code| {
            let before = registers[PC];
            assert!(go_past(code, &mut registers));
            registers[PC].wrapping_sub(before) as i32
        };
        // cmp r1, r2; bne to 36 before what would be fetched; cmp r1, r1; bne; b to 0x448 on.
        assert_eq!(go([0x4291, 0]), 2);
        assert_eq!(go([0xD1EE, 0]), -32);
        assert_eq!(go([0x4289, 0]), 2);
        assert_eq!(go([0xD1EE, 0]), 2);
        assert_eq!(go([0xE09E, 0]), 4 + 2 * 0x9E);
    }

    /// Against comparisons of numbers with and without sign.
    #[test]
    fn conditions_are_those_of_a_comparison() {
        let values = [0, 1, 2, 0x7FFF_FFFF, 0x8000_0000, 0x8000_0001, u32::MAX];
        for (a, b) in values.iter().flat_map(|a| values.map(|b| (*a, b))) {
            let mut registers = registers();
            registers[..2].copy_from_slice(&[a, b]);
            // cmp r0, r1.
            assert!(go_past([0x4288, 0], &mut registers));
            let status = registers[STATUS];
            let (sa, sb) = (a as i32, b as i32);
            let difference = sa.wrapping_sub(sb);
            let overflows = sa.checked_sub(sb).is_none();
            let expected = [
                a == b,
                a >= b,
                difference < 0,
                overflows,
                a > b,
                sa >= sb,
                sa > sb,
            ];
            for (condition, expected) in (0u32..).step_by(2).zip(expected) {
                let held = holds(condition, status);
                assert_eq!(held, expected, "{condition} {a:x} {b:x}");
                assert_eq!(holds(condition + 1, status), !expected);
            }
        }
    }
}
