//! A debug probe, by `probe-rs` (0.24 and later): <https://probe.rs>.
//!
//! Entry points: [`ProbeRs::all`], [`ProbeRs::one`].

use crate::program::Program;
use crate::target::{Chip, FLASH_START, Target};
use crate::{FlashError, Loader};
use std::fs;

const PROGRAM: Program = Program {
    name: "probe-rs",
    what: "through a probe",
    install: "install it as https://probe.rs/docs/getting-started/installation says (`cargo install probe-rs-tools --locked`); \
without a probe: --method dfu, over USB",
};

/// Where the chip says what it is (DBGMCU_IDCODE; RM0090, 38.6.1).
const ID_CODE: &str = "0xE0042000";

/// A probe with a board on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProbeRs {
    /// As `--probe` takes it: `VENDOR:PRODUCT:SERIAL`.
    pub probe: String,
    chip: &'static str,
}

impl ProbeRs {
    /// All probes.
    ///
    /// # Errors
    /// Those of the program.
    pub fn all() -> Result<Vec<String>, FlashError> {
        let [said, _] = PROGRAM.run(&["list"])?;
        Ok(said.lines().filter_map(listed).collect())
    }

    /// The probe that is named so, or the only one, with this board on it.
    ///
    /// # Errors
    /// [`FlashError::NoProbe`], [`FlashError::Several`], [`FlashError::NotThere`], and those of the program.
    pub fn one(probe: Option<&str>, board: &Target) -> Result<ProbeRs, FlashError> {
        let mut found = ProbeRs::all()?;
        let chip = board.chip;
        if let Some(probe) = probe {
            let place = found.iter().position(|one| one.eq_ignore_ascii_case(probe));
            let device = probe.to_owned();
            return match place {
                Some(place) => Ok(ProbeRs {
                    probe: found.swap_remove(place),
                    chip,
                }),
                None => Err(FlashError::NotThere { device, found }),
            };
        }
        match found.as_slice() {
            [] => Err(FlashError::NoProbe),
            [only] => Ok(ProbeRs {
                probe: only.clone(),
                chip,
            }),
            _ => Err(FlashError::Several { found }),
        }
    }

    fn run(&self, command: &str, more: &[&str]) -> Result<String, FlashError> {
        let which = [command, "--chip", self.chip, "--probe", &self.probe];
        let [said, _] = PROGRAM.run(&[&which[..], more].concat())?;
        Ok(said)
    }
}

/// A line of `probe-rs list`: `[0]: STLink V2-1 -- 0483:374b:066BFF (ST-LINK)`.
fn listed(line: &str) -> Option<String> {
    let (number, rest) = line.strip_prefix('[')?.split_once("]: ")?;
    number.parse::<u32>().ok()?;
    let (_, probe) = rest.rsplit_once(" -- ")?;
    probe.split_whitespace().next().map(str::to_owned)
}

impl Loader for ProbeRs {
    fn chip(&mut self) -> Result<Chip, FlashError> {
        let said = self.run("read", &["b32", ID_CODE, "1"])?;
        // `e0042000: 10076413`, or the number alone.
        let word = said.split_whitespace().next_back().unwrap_or_default();
        let code = u32::from_str_radix(word, 16).map_err(|_| FlashError::Program {
            command: format!("probe-rs read b32 {ID_CODE} 1"),
            said: format!("said `{}`, which is no number", said.trim()),
        })?;
        Ok(Chip::Id(code & 0xFFF))
    }

    fn read(&mut self, offset: usize, length: usize) -> Result<Vec<u8>, FlashError> {
        let broken = |source| PROGRAM.file_error(source);
        let folder = tempfile::tempdir().map_err(broken)?;
        let file = folder.path().join("read.bin");
        let address = format!("{:#010x}", FLASH_START as usize + offset);
        let words = length.div_ceil(4).to_string();
        let to = file.to_string_lossy();
        self.run(
            "read",
            &[
                "b32", &address, &words, "--format", "binary", "--output", &to,
            ],
        )?;
        let mut bytes = fs::read(&file).map_err(broken)?;
        bytes.truncate(length);
        Ok(bytes)
    }

    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), FlashError> {
        let broken = |source| PROGRAM.file_error(source);
        let folder = tempfile::tempdir().map_err(broken)?;
        let file = folder.path().join("write.bin");
        fs::write(&file, bytes).map_err(broken)?;
        let address = format!("{:#010x}", FLASH_START as usize + offset);
        let from = file.to_string_lossy();
        let format = ["--binary-format", "bin", "--base-address", &address];
        self.run(
            "download",
            &[&format[..], &["--disable-progressbars", &from]].concat(),
        )?;
        Ok(())
    }

    fn start(&mut self) -> Result<(), FlashError> {
        self.run("reset", &[]).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probes_are_read_from_the_list() {
        let line = "[0]: STLink V2-1 -- 0483:374b:066BFF485457725187052924 (ST-LINK)";
        assert_eq!(
            listed(line).as_deref(),
            Some("0483:374b:066BFF485457725187052924")
        );
        let line = "[12]: A probe -- of mine -- 0d28:0204 (CMSIS-DAP)";
        assert_eq!(listed(line).as_deref(), Some("0d28:0204"));
        for other in [
            "The following debug probes were found:",
            "No debug probes were found.",
            "",
        ] {
            assert_eq!(listed(other), None);
        }
    }
}
