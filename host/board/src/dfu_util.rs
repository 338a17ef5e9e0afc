//! The loader in the chip's ROM, over USB, by `dfu-util` (0.11): <https://dfu-util.sourceforge.net>.
//!
//! Entry points: [`DfuUtil::all`], [`DfuUtil::one`]. The loader tells of the chip how large its flash is, in the name of that memory
//! (ST AN3156; UM0424, 10.3.2), and nothing else: it has no access to the chip's own number.

use crate::program::Program;
use crate::target::{Chip, FLASH_START};
use crate::{FlashError, Loader};
use std::fs;

const PROGRAM: Program = Program {
    name: "dfu-util",
    what: "a board that is in the loader of its ROM",
    install: "install it: `sudo apt install dfu-util`, `brew install dfu-util`, or for Windows from dfu-util.sourceforge.net (its driver: Zadig, WinUSB); \
with a probe it does without: --method probe",
};

/// The loader of ST's chips, by its vendor and product number.
const LOADER: &str = "0483:df11";

/// A board in its ROM's loader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DfuUtil {
    /// Its number: the loader's own, which is not the console's.
    pub serial: String,
    flash_bytes: usize,
}

impl DfuUtil {
    /// All boards in their ROM's loader.
    ///
    /// # Errors
    /// [`FlashError::NoAccess`] if there are only some that this user may not open, and those of the program.
    pub fn all() -> Result<Vec<DfuUtil>, FlashError> {
        let [said, complaints] = PROGRAM.run(&["-l", "-d", LOADER])?;
        let found: Vec<_> = said.lines().filter_map(listed).collect();
        let mut complaints = complaints.lines();
        match complaints.find(|line| line.contains("Cannot open DFU device")) {
            Some(line) if found.is_empty() => Err(FlashError::NoAccess {
                said: line.trim().to_owned(),
            }),
            _ => Ok(found),
        }
    }

    /// The one of this number, or the only one.
    ///
    /// # Errors
    /// [`FlashError::NoLoader`], [`FlashError::Several`], [`FlashError::NotThere`], and those of the program.
    pub fn one(serial: Option<&str>) -> Result<DfuUtil, FlashError> {
        let mut all = DfuUtil::all()?;
        let found = all.iter().map(|one| one.serial.clone()).collect::<Vec<_>>();
        if let Some(serial) = serial {
            let place = found
                .iter()
                .position(|one| one.eq_ignore_ascii_case(serial));
            let device = serial.to_owned();
            return match place {
                Some(place) => Ok(all.swap_remove(place)),
                None => Err(FlashError::NotThere { device, found }),
            };
        }
        match all.pop() {
            None => Err(FlashError::NoLoader),
            Some(only) if all.is_empty() => Ok(only),
            Some(_) => Err(FlashError::Several { found }),
        }
    }

    fn run(&self, memory: &str, more: &[&str]) -> Result<(), FlashError> {
        let which = ["-d", LOADER, "-S", &self.serial, "-a", "0", "-s", memory];
        PROGRAM.run(&[&which[..], more].concat()).map(|_| ())
    }
}

/// A line of `dfu-util -l`, if it is that of a chip's flash: `Found DFU: [0483:df11] ..., alt=0, name="@Internal Flash
/// /0x08000000/04*016Kg,01*064Kg,07*128Kg", serial="..."`.
fn listed(line: &str) -> Option<DfuUtil> {
    let quoted = |key: &str| line.split_once(key)?.1.split('"').next();
    let name = quoted("name=\"")?;
    let serial = quoted("serial=\"")?.to_owned();
    let (kind, layout) = name
        .strip_prefix("@Internal Flash")?
        .split_once("/0x08000000/")?;
    (kind.trim().is_empty()).then_some(())?;
    // Areas of so many sectors of so many bytes or kilobytes, with a letter for what may be done with them.
    let area = |text: &str| {
        let (count, size) = text.split_once('*')?;
        let unit = size
            .trim_end()
            .trim_end_matches(|letter: char| ('a'..='g').contains(&letter));
        let (digits, unit) = match unit.trim_end().strip_suffix('K') {
            Some(digits) => (digits, 1024),
            None => (unit.trim_end_matches(['B', ' ']), 1),
        };
        Some(count.parse::<usize>().ok()? * digits.parse::<usize>().ok()? * unit)
    };
    let areas = layout.split(',').map(area);
    Some(DfuUtil {
        serial,
        flash_bytes: areas.sum::<Option<usize>>()?,
    })
}

impl Loader for DfuUtil {
    fn chip(&mut self) -> Result<Chip, FlashError> {
        Ok(Chip::Flash(self.flash_bytes))
    }

    fn read(&mut self, offset: usize, length: usize) -> Result<Vec<u8>, FlashError> {
        let broken = |source| PROGRAM.file_error(source);
        // It does not write into a file that is there.
        let folder = tempfile::tempdir().map_err(broken)?;
        let file = folder.path().join("read.bin");
        let memory = format!("{:#010x}:{length}", FLASH_START as usize + offset);
        self.run(&memory, &["-U", &file.to_string_lossy()])?;
        fs::read(file).map_err(broken)
    }

    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), FlashError> {
        let broken = |source| PROGRAM.file_error(source);
        let folder = tempfile::tempdir().map_err(broken)?;
        let file = folder.path().join("write.bin");
        fs::write(&file, bytes).map_err(broken)?;
        let memory = format!("{:#010x}", FLASH_START as usize + offset);
        self.run(&memory, &["-D", &file.to_string_lossy()])
    }

    fn start(&mut self) -> Result<(), FlashError> {
        self.run(&format!("{FLASH_START:#010x}:leave"), &[])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines as `dfu-util` 0.11 prints them, of the loaders' names in ST AN2606 and UM0424.
    #[test]
    fn boards_in_their_loader_are_read_from_the_list() {
        let line = |name: &str| {
            format!(
                "Found DFU: [0483:df11] ver=2200, devnum=9, cfg=1, intf=0, path=\"1-4\", alt=0, name=\"{name}\", serial=\"345F37823336\""
            )
        };
        let flash = |name: &str| listed(&line(name)).map(|found| found.flash_bytes / 1024);
        let f405 = "@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg";
        assert_eq!(flash(f405), Some(1024));
        assert_eq!(
            listed(&line(f405)).map(|found| found.serial).as_deref(),
            Some("345F37823336")
        );
        assert_eq!(
            flash("@Internal Flash  /0x08000000/04*016Kg,01*064Kg,03*128Kg"),
            Some(512)
        );
        assert_eq!(flash("@Internal Flash  /0x08000000/64*0001Kg"), Some(64));
        for other in [
            "@Option Bytes  /0x1FFFC000/01*016 e",
            "@OTP Memory /0x1FFF7800/01*512 e,01*016 e",
            "@Device Feature/0xFFFF0000/01*004 e",
            "@Internal Flash  /0x08000000/some",
            "",
        ] {
            assert_eq!(flash(other), None, "{other}");
        }
        assert_eq!(listed("dfu-util 0.11"), None);
    }
}
