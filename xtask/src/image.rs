//! What an image weighs, and which ways to panic it still has. Entry point: [`read`].

use crate::calls::Calls;
use anyhow::{Context, Result};
use object::elf::{SHF_ALLOC, SHF_WRITE};
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SectionKind};
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::Path;

/// Size of an image, as `size` of the binutils counts it, and its panics.
#[derive(Debug, Default, PartialEq, Eq, Serialize)]
pub struct Image {
    /// Code and constants, in flash \[bytes\].
    pub text: u64,
    /// Initialised variables, in flash and RAM \[bytes\].
    pub data: u64,
    /// Other variables, in RAM, without the stack \[bytes\].
    pub bss: u64,
    /// Functions of the core library that panic, without type arguments.
    pub panic_symbols: BTreeSet<String>,
    /// How the control task can come to panic: names of functions, from the task on; empty if it cannot.
    pub panic_in_control: Vec<String>,
}

/// The interrupt handler that the control task is.
const CONTROL: &str = "TIM7";

/// Reads an ELF image.
pub fn read(path: &Path) -> Result<Image> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let file =
        object::File::parse(&*bytes).with_context(|| format!("{} is no image", path.display()))?;
    let mut image = Image::default();
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else {
            continue;
        };
        if sh_flags & u64::from(SHF_ALLOC) == 0 {
            continue;
        }
        let part = if section.kind() == SectionKind::UninitializedData {
            &mut image.bss
        } else if sh_flags & u64::from(SHF_WRITE) != 0 {
            &mut image.data
        } else {
            &mut image.text
        };
        *part += section.size();
    }
    for symbol in file.symbols() {
        if let Ok(name) = symbol.name() {
            let name = format!("{:#}", rustc_demangle::demangle(name));
            if is_panic(&name) {
                image.panic_symbols.insert(without_arguments(&name));
            }
        }
    }
    let calls = Calls::read(&file);
    let way = calls.path_to(CONTROL, is_panic)?;
    image.panic_in_control = way.into_iter().flatten().map(str::to_owned).collect();
    Ok(image)
}

/// Whether a function of the core library only exists to panic.
fn is_panic(name: &str) -> bool {
    name.starts_with("core::")
        && name
            .split("::")
            .any(|part| part == "panicking" || part.starts_with("panic_") || part.contains("_fail"))
        && !name.starts_with("core::panic::")
}

/// The name without `<..>` arguments, which carry hashes of crates.
fn without_arguments(name: &str) -> String {
    let mut depth = 0_usize;
    name.chars()
        .filter(|&letter| {
            depth += usize::from(letter == '<');
            let keep = depth == 0;
            depth = depth.saturating_sub(usize::from(letter == '>'));
            keep
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_are_told_from_other_functions() {
        for name in [
            "core::panicking::panic_fmt",
            "core::panicking::panic_bounds_check",
            "core::result::unwrap_failed",
            "core::option::expect_failed",
            "core::slice::index::slice_index_fail::do_panic::runtime",
            "core::slice::copy_from_slice_impl::len_mismatch_fail",
            "core::cell::panic_already_borrowed",
        ] {
            assert!(is_panic(name), "{name}");
        }
        for name in [
            "sutura_shared::control::Control::tick",
            "core::fmt::write",
            "core::panic::panic_info::PanicInfo::location",
            "my::failing::thing_fail",
        ] {
            assert!(!is_panic(name), "{name}");
        }
    }

    #[test]
    fn type_arguments_go() {
        assert_eq!(
            without_arguments("core::panicking::assert_failed::<usize, a::B<u8>>"),
            "core::panicking::assert_failed::"
        );
        assert_eq!(
            without_arguments("core::panicking::panic"),
            "core::panicking::panic"
        );
    }
}
