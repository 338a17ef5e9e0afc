//! Which functions a function of an image can reach, by its branches. Entry point: [`Calls::path_to`].
//!
//! Decodes only Thumb-2 `BL` and `B.W` (Arm v7-M manual, A7.7.18 and A7.7.12); calls through pointers are
//! not followed.

use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};
use std::collections::BTreeMap;

/// The direct calls of an image.
pub struct Calls {
    /// Functions by address: name, addresses that it branches to outside of itself.
    functions: BTreeMap<u64, (String, Vec<u64>)>,
}

impl Calls {
    /// Reads the code of an ELF image for a Cortex-M.
    pub fn read(file: &object::File) -> Self {
        // The linker marks where code ($t) and constants ($d) begin.
        let mut marks = BTreeMap::new();
        for symbol in file.symbols() {
            match symbol.name() {
                Ok(name) if name.starts_with("$d") => marks.insert(symbol.address(), false),
                Ok(name) if name.starts_with("$t") => marks.insert(symbol.address(), true),
                _ => None,
            };
        }
        let is_code = |address: u64| {
            marks
                .range(..=address)
                .next_back()
                .is_none_or(|(_, &code)| code)
        };
        let mut functions = BTreeMap::new();
        for symbol in file.symbols() {
            let Ok(name) = symbol.name() else { continue };
            // Bit 0 of a function's address says Thumb.
            let start = symbol.address() & !1;
            let section = symbol
                .section_index()
                .and_then(|index| file.section_by_index(index).ok());
            let code =
                section.and_then(|section| section.data_range(start, symbol.size()).ok().flatten());
            let (SymbolKind::Text, Some(code)) = (symbol.kind(), code) else {
                continue;
            };
            let name = format!("{:#}", rustc_demangle::demangle(name));
            let inside = start..start + symbol.size();
            let mut targets = branches(code, start, is_code);
            targets.retain(|target| !inside.contains(target));
            functions.entry(start).or_insert((name, targets));
        }
        Self { functions }
    }

    /// The names on a way of calls from the function `from` to one that `wanted` picks; `None` if there is
    /// none, an error if there is no function `from`.
    pub fn path_to(
        &self,
        from: &str,
        wanted: impl Fn(&str) -> bool,
    ) -> anyhow::Result<Option<Vec<&str>>> {
        let start = self.functions.iter().find(|(_, (name, _))| name == from);
        let Some((&start, _)) = start else {
            anyhow::bail!("the image has no function {from}")
        };
        let mut came_from = BTreeMap::from([(start, start)]);
        let mut todo = vec![start];
        while let Some(place) = todo.pop() {
            let Some((name, targets)) = self.functions.get(&place) else {
                continue;
            };
            if wanted(name) {
                return Ok(Some(self.way(&came_from, start, place)));
            }
            for &target in targets {
                came_from.entry(target).or_insert_with(|| {
                    todo.push(target);
                    place
                });
            }
        }
        Ok(None)
    }

    fn way(&self, came_from: &BTreeMap<u64, u64>, start: u64, mut place: u64) -> Vec<&str> {
        let mut way = Vec::new();
        loop {
            way.extend(self.functions.get(&place).map(|(name, _)| name.as_str()));
            match came_from.get(&place) {
                Some(&before) if place != start => place = before,
                _ => break,
            }
        }
        way.reverse();
        way
    }
}

/// Targets of the branches in `code`, which lies at `start`.
fn branches(code: &[u8], start: u64, is_code: impl Fn(u64) -> bool) -> Vec<u64> {
    let halves: Vec<u16> = code
        .as_chunks()
        .0
        .iter()
        .map(|&half| u16::from_le_bytes(half))
        .collect();
    let mut targets = Vec::new();
    let mut index = 0;
    while let Some(&first) = halves.get(index) {
        let address = start + 2 * index as u64;
        // A7.3.1: the first half of a 32-bit instruction.
        let wide = first >> 11 >= 0b11101;
        if is_code(address)
            && wide
            && let Some(&second) = halves.get(index + 1)
        {
            targets.extend(branch_target(first, second, address));
            index += 1;
        }
        index += 1;
    }
    targets
}

/// Target of a `BL` or `B.W` at `address`.
fn branch_target(first: u16, second: u16, address: u64) -> Option<u64> {
    if first >> 11 != 0b11110 || second & 0x9000 != 0x9000 {
        return None;
    }
    let bit = |half: u16, index: u16| u32::from(half >> index & 1);
    let sign = bit(first, 10);
    let (i1, i2) = (bit(second, 13) ^ sign ^ 1, bit(second, 11) ^ sign ^ 1);
    let imm = sign << 24
        | i1 << 23
        | i2 << 22
        | u32::from(first & 0x3FF) << 12
        | u32::from(second & 0x7FF) << 1;
    // Sign-extended from 25 bits.
    let offset = i64::from((imm << 7) as i32 >> 7);
    Some(address.wrapping_add_signed(offset + 4))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodings as llvm-mc 14 prints them for thumbv7em.
    #[test]
    fn branches_are_decoded() {
        assert_eq!(
            branch_target(0xF7FF, 0xFFFE, 0x0800_0100),
            Some(0x0800_0100)
        ); // bl .
        assert_eq!(
            branch_target(0xF000, 0xF800, 0x0800_0100),
            Some(0x0800_0104)
        ); // bl .+4
        assert_eq!(
            branch_target(0xF000, 0xFD0C, 0x0800_65C0),
            Some(0x0800_6FDC)
        ); // bl .+2588
        assert_eq!(
            branch_target(0xF7FF, 0xBFFE, 0x0800_0100),
            Some(0x0800_0100)
        ); // b.w .
        assert_eq!(branch_target(0xF8D0, 0x1008, 0x0800_0100), None); // ldr.w r1, [r0, #8]
        assert_eq!(branch_target(0xF43F, 0xAFFE, 0x0800_0100), None); // beq.w .
    }

    #[test]
    fn constants_between_code_are_no_branches() {
        let code = [0xFF, 0xF7, 0xFE, 0xFF, 0x00, 0xF0, 0x00, 0xF8];
        assert_eq!(branches(&code, 0x100, |_| true), [0x100, 0x108]);
        assert_eq!(branches(&code, 0x100, |address| address < 0x104), [0x100]);
    }

    #[test]
    fn a_way_is_found_through_other_functions_and_loops_end() {
        let function = |name: &str, targets: &[u64]| (name.to_owned(), targets.to_vec());
        let calls = Calls {
            functions: BTreeMap::from([
                (0, function("TIM7", &[8, 16])),
                (8, function("tick", &[0, 8])),
                (16, function("swap", &[24])),
                (24, function("core::panicking::panic", &[])),
                (32, function("USART1", &[8])),
            ]),
        };
        let panic = |name: &str| name.contains("panicking");
        let way = calls.path_to("TIM7", panic).expect("TIM7 exists");
        assert_eq!(way, Some(vec!["TIM7", "swap", "core::panicking::panic"]));
        let way = calls.path_to("USART1", panic).expect("USART1 exists");
        assert_eq!(way.map(|way| way.len()), Some(5));
        assert_eq!(
            calls
                .path_to("tick", |name| name == "USART1")
                .expect("tick exists"),
            None
        );
        assert!(calls.path_to("TIM8", panic).is_err());
    }
}
