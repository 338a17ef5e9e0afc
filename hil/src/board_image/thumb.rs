//! Loads and stores of the ARMv7-M instruction set, one at a time: what the image was about to do to a register.
//!
//! Entry point: [`Access::decode`]. Encodings: ARMv7-M Architecture Reference Manual, A5.2.4, A5.3.7 to A5.3.10, and
//! A7.7 of each instruction. Not here: pairs, multiples, exclusives and floating-point registers, with which no compiler touches a
//! device.

/// A load or store of one integer register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// Address.
    pub address: u32,
    /// Whether the register is loaded.
    pub load: bool,
    /// Bytes.
    pub size: u32,
    /// Loaded with the sign of what is shorter than a word.
    signed: bool,
    /// Number of the register.
    pub register: usize,
    /// Base register, and what it becomes.
    pub write_back: Option<(usize, u32)>,
    /// Length of the instruction \[bytes\].
    pub length: u32,
}

impl Access {
    /// Reads the instruction whose halfwords these are (the second one counts only where it has two), with registers r0 to r15.
    ///
    /// None if it is something else.
    pub fn decode(code: [u16; 2], registers: &[u32; 16]) -> Option<Access> {
        let [first, second] = code.map(u32::from);
        if first >> 11 < 0b11101 {
            short(first, registers)
        } else {
            long(first, second, registers)
        }
    }

    /// What a load leaves in the register, of a word at the address.
    pub fn loaded(&self, word: u32) -> u32 {
        match (self.size, self.signed) {
            (1, false) => word & 0xFF,
            (1, true) => word as i8 as u32,
            (2, false) => word & 0xFFFF,
            (2, true) => word as i16 as u32,
            _ => word,
        }
    }
}

/// Instructions of 16 bits.
fn short(code: u32, registers: &[u32; 16]) -> Option<Access> {
    let field = |at: u32| code as usize >> at & 7;
    let access = |load, size: u32, signed, offset: u32| Access {
        address: registers[field(3)].wrapping_add(offset),
        load,
        size,
        signed,
        register: field(0),
        write_back: None,
        length: 2,
    };
    let scaled = code >> 6 & 31;
    Some(match code >> 11 {
        0b01010 | 0b01011 => {
            let by = registers[field(6)];
            let (load, size, signed) = match code >> 9 & 7 {
                0 => (false, 4, false),
                1 => (false, 2, false),
                2 => (false, 1, false),
                3 => (true, 1, true),
                4 => (true, 4, false),
                5 => (true, 2, false),
                6 => (true, 1, false),
                _ => (true, 2, true),
            };
            access(load, size, signed, by)
        }
        0b01100 => access(false, 4, false, 4 * scaled),
        0b01101 => access(true, 4, false, 4 * scaled),
        0b01110 => access(false, 1, false, scaled),
        0b01111 => access(true, 1, false, scaled),
        0b10000 => access(false, 2, false, 2 * scaled),
        0b10001 => access(true, 2, false, 2 * scaled),
        _ => return None,
    })
}

/// Instructions of 32 bits.
fn long(first: u32, second: u32, registers: &[u32; 16]) -> Option<Access> {
    let size = match (first & 0xFE00, first >> 5 & 3) {
        (0xF800, size @ 0..=2) => 1 << size,
        _ => return None,
    };
    let base = first as usize & 15;
    let before = registers[base];
    let (address, after) = if first & 1 << 7 != 0 {
        (before.wrapping_add(second & 0xFFF), None)
    } else if second & 1 << 11 != 0 {
        let offset = second & 0xFF;
        let moved = if second & 1 << 9 != 0 {
            before.wrapping_add(offset)
        } else {
            before.wrapping_sub(offset)
        };
        let indexed = second & 1 << 10 != 0;
        let written = second & 1 << 8 != 0;
        (
            if indexed { moved } else { before },
            written.then_some(moved),
        )
    } else if second >> 6 & 31 == 0 {
        let by = registers[second as usize & 15] << (second >> 4 & 3);
        (before.wrapping_add(by), None)
    } else {
        return None;
    };
    Some(Access {
        address,
        load: first & 1 << 4 != 0,
        size,
        signed: first & 1 << 8 != 0,
        register: second as usize >> 12,
        write_back: after.map(|after| (base, after)),
        length: 4,
    })
}

/// The status word after an instruction of an IT block; the same outside of one.
pub fn past_it(status: u32) -> u32 {
    let state = status >> 8 & 0xFC | status >> 25 & 3;
    if state == 0 {
        return status;
    }
    let next = if state & 7 == 0 {
        0
    } else {
        state & 0xE0 | state << 1 & 0x1F
    };
    status & !0x0600_FC00 | (next & 0xFC) << 8 | (next & 3) << 25
}

#[cfg(test)]
mod tests {
    use super::*;

    const R: [u32; 16] = [
        0x5000_0000,
        0x20,
        0x4001_0400,
        8,
        0,
        0,
        0,
        0,
        0x5000_0900,
        0,
        0,
        0,
        0x2000_0000,
        0,
        0,
        0x0800_0000,
    ];

    /// Encodings as an assembler (LLVM 14) gives them.
    #[test]
    fn what_an_assembler_writes_is_read() {
        let read = |first, second| Access::decode([first, second], &R).expect("a load or store");
        // ldr r1, [r0, #64]; str r3, [r1, #16] with r1 = 0x20.
        let load = read(0x6C01, 0);
        assert_eq!(
            (load.address, load.load, load.register, load.length),
            (0x5000_0040, true, 1, 2)
        );
        let store = read(0x610B, 0);
        assert_eq!(
            (store.address, store.load, store.register),
            (0x30, false, 3)
        );
        // ldr.w r1, [r8, #24]; str.w r1, [r8, #16].
        assert_eq!(read(0xF8D8, 0x1018).address, 0x5000_0918);
        assert!(!read(0xF8C8, 0x1010).load);
        // strh.w r12, [r1, #1024]; strh r0, [r1].
        let halfword = read(0xF8A1, 0xC400);
        assert_eq!(
            (halfword.address, halfword.size, halfword.register),
            (0x420, 2, 12)
        );
        assert_eq!((read(0x8008, 0).size, read(0x8008, 0).load), (2, false));
        // ldr r3, [r0, r1]; ldrsh r3, [r0, r1]; ldrb.w r4, [r2, r3, lsl #1].
        assert_eq!(read(0x5843, 0).address, 0x5000_0020);
        assert_eq!(read(0x5E43, 0).loaded(0x8000), 0xFFFF_8000);
        assert_eq!(read(0xF812, 0x4013).address, 0x4001_0410);
        // ldr r1, [r0], #4; ldr r1, [r0, #-4]; str r1, [r0, #8]!
        let after = read(0xF850, 0x1B04);
        assert_eq!(
            (after.address, after.write_back),
            (0x5000_0000, Some((0, 0x5000_0004)))
        );
        assert_eq!(read(0xF850, 0x1C04).address, 0x4FFF_FFFC);
        let before = read(0xF840, 0x1F08);
        assert_eq!(
            (before.address, before.write_back),
            (0x5000_0008, Some((0, 0x5000_0008)))
        );
    }

    #[test]
    fn what_is_no_load_or_store_of_one_register_is_refused() {
        // adds r1, r5, r2; b.n; ldrd r3, r4, [r0]; vstr s0, [r0]; ldrex r3, [r2, #12]; mov.w r3, #524288.
        for code in [
            [0x18A9, 0],
            [0xE09E, 0],
            [0xE9D0, 0x3400],
            [0xED80, 0x0A00],
            [0xE852, 0x3F03],
            [0xF44F, 0x2300],
        ] {
            assert_eq!(Access::decode(code, &R), None, "{code:04x?}");
        }
    }

    /// ITTE EQ is 0x06: two more instructions after the first, then none (A7.3.2).
    #[test]
    fn an_it_block_goes_on_one_instruction() {
        let status = |state: u32| 0x0100_0000 | (state & 0xFC) << 8 | (state & 3) << 25;
        assert_eq!(past_it(status(0x06)), status(0x0C));
        assert_eq!(past_it(status(0x0C)), status(0x18));
        assert_eq!(past_it(status(0x18)), status(0));
        assert_eq!(past_it(0x6100_0000), 0x6100_0000);
    }
}
