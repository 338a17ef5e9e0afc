//! What QEMU logs of accesses to blocks that it does not have: every read, which gave 0, and every write, with its value.
//!
//! Entry point: [`Log::accesses`]. Reading the log costs no stop of the processor, so that only registers that are not 0 have to be
//! watched. QEMU flushes each line before the access is over.

use std::fs::File;
use std::io::{self, Read};
use std::path::PathBuf;

/// Blocks by the names that QEMU gives them (hw/arm/stm32f405_soc.c).
const BLOCKS: [(&str, u32); 17] = [
    ("timer[7]", 0x4000_1400),
    ("WWDG", 0x4000_2C00),
    ("IWDG", 0x4000_3000),
    // At the same place, and before it.
    ("I2S2ext", 0x4000_3000),
    ("PWR", 0x4000_7000),
    ("timer[1]", 0x4001_0000),
    ("timer[8]", 0x4001_0400),
    ("GPIOA", 0x4002_0000),
    ("GPIOB", 0x4002_0400),
    ("GPIOC", 0x4002_0800),
    ("GPIOD", 0x4002_0C00),
    ("GPIOE", 0x4002_1000),
    ("GPIOG", 0x4002_1800),
    ("RCC", 0x4002_3800),
    ("Flash Int", 0x4002_3C00),
    ("USB OTG FS", 0x5000_0000),
    ("RNG", 0x5006_0800),
];

/// Whether a register is of such a block.
pub fn is_lacking(address: u32) -> bool {
    BLOCKS.iter().any(|(name, base)| {
        // QEMU gives the USB core as much as its FIFOs take, and all others a kilobyte.
        let length = if *name == "USB OTG FS" {
            0x3_1000
        } else {
            0x400
        };
        (*base..base + length).contains(&address)
    })
}

/// An access to a block that QEMU does not have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Logged {
    /// Address.
    pub address: u32,
    /// What was written; a read gave 0.
    pub written: Option<u32>,
}

/// QEMU's log, read as it grows.
#[derive(Debug)]
pub struct Log {
    path: PathBuf,
    file: Option<File>,
    /// A line whose end has not come yet.
    rest: String,
}

impl Log {
    /// The log that QEMU writes there; it need not be there yet.
    pub fn new(path: PathBuf) -> Log {
        Log {
            path,
            file: None,
            rest: String::new(),
        }
    }

    /// What has been logged since this was last asked, in order.
    ///
    /// # Errors
    /// What the system says.
    pub fn accesses(&mut self) -> io::Result<Vec<Logged>> {
        if self.file.is_none() {
            match File::open(&self.path) {
                Ok(file) => self.file = Some(file),
                Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
                Err(error) => return Err(error),
            }
        }
        if let Some(file) = &mut self.file {
            file.read_to_string(&mut self.rest)?;
        }
        let whole = self.rest.rfind('\n').map_or(0, |end| end + 1);
        let accesses = self.rest[..whole].lines().filter_map(access).collect();
        self.rest.drain(..whole);
        Ok(accesses)
    }
}

/// `RCC: unimplemented device write (size 4, offset 0x08, value 0x0000940a)`, or `... read  (size 4, offset 0x08)`.
fn access(line: &str) -> Option<Logged> {
    let (name, what) = line.split_once(": unimplemented device ")?;
    let (_, base) = BLOCKS.iter().find(|(block, _)| *block == name)?;
    let number = |key: &str| {
        let (_, after) = what.split_once(key)?;
        let digits = after.split([',', ')']).next()?;
        u32::from_str_radix(digits, 16).ok()
    };
    let written = match what.starts_with("write") {
        true => Some(number("value 0x")?),
        false => None,
    };
    Some(Logged {
        address: base + number("offset 0x")?,
        written,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    /// Lines of QEMU 7.2.
    #[test]
    fn lines_become_accesses_and_others_do_not() {
        let read = access("RCC: unimplemented device read  (size 4, offset 0x040)");
        assert_eq!(
            read,
            Some(Logged {
                address: 0x4002_3840,
                written: None
            })
        );
        let write =
            access("I2S2ext: unimplemented device write (size 2, offset 0x000, value 0x0000cccc)");
        assert_eq!(
            write,
            Some(Logged {
                address: 0x4000_3000,
                written: Some(0xCCCC)
            })
        );
        assert_eq!(access("NVIC: Bad read offset 0xdfc"), None);
        assert_eq!(
            access("SDIO: unimplemented device read  (size 4, offset 0x000)"),
            None
        );
    }

    #[test]
    fn registers_of_blocks_are_lacking_and_others_not() {
        // GPIOB's, the last word of the last FIFO; a timer's, the interrupt controller's, RAM.
        for address in [0x4002_0410, 0x5000_0010, 0x5003_0FFC] {
            assert!(is_lacking(address), "{address:#x}");
        }
        for address in [0x4000_0024, 0x4000_0C24, 0xE000_E200, 0x2000_0000] {
            assert!(!is_lacking(address), "{address:#x}");
        }
    }

    #[test]
    fn half_a_line_waits_for_its_end() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("log");
        let mut log = Log::new(path.clone());
        assert_eq!(log.accesses().expect("no file, no access"), []);
        let mut file = File::create(path).expect("a file");
        write!(
            file,
            "RNG: unimplemented device read  (size 4, offset 0x04)\nPWR: unimpl"
        )
        .expect("room");
        assert_eq!(log.accesses().expect("readable").len(), 1);
        writeln!(file, "emented device read  (size 4, offset 0x04)").expect("room");
        assert_eq!(
            log.accesses().expect("readable")[0].address,
            0x4000_7004,
            "whole now"
        );
    }
}
