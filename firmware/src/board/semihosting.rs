//! What the emulator lends to the image: its command line, files, an exit code.
//!
//! Operations as in Arm's "Semihosting for AArch32 and AArch64" (2023). None costs virtual time.

use core::str;
use cortex_m_semihosting::{debug, nr, syscall};

/// A file or named pipe of the machine that runs the emulator.
pub struct File(usize);

/// How a file is opened.
#[derive(Clone, Copy)]
pub enum Access {
    /// For reading.
    Read = nr::open::R_BINARY as isize,
    /// For writing.
    Write = nr::open::W_TRUNC_BINARY as isize,
}

impl File {
    /// Opens a file; a named pipe waits for its other end.
    pub fn open(path: &str, access: Access) -> Option<Self> {
        Self::open_mode(path, access as usize)
    }

    fn open_mode(path: &str, mode: usize) -> Option<Self> {
        // The operation takes a terminated string and its length.
        let mut name = [0; 256];
        name.get_mut(..path.len())?.copy_from_slice(path.as_bytes());
        if path.len() == name.len() {
            return None;
        }
        let block = [name.as_ptr().addr(), mode, path.len()];
        // SAFETY: a terminated string of the given length, alive during the call; it is only read.
        let handle = unsafe { syscall(nr::OPEN, &block) };
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Fills `bytes`, waiting as long as it takes; false at the end of the file.
    pub fn read_exact(&self, mut bytes: &mut [u8]) -> bool {
        while !bytes.is_empty() {
            let block = [self.0, bytes.as_mut_ptr().expose_provenance(), bytes.len()];
            // SAFETY: the operation writes at most the given length into the buffer, which is borrowed
            // mutably here, and returns how many bytes it did not write.
            let left = unsafe { syscall(nr::READ, &block) };
            if left >= bytes.len() {
                return false;
            }
            let read = bytes.len() - left;
            bytes = &mut bytes[read..];
        }
        true
    }

    /// Writes all of `bytes`; false if nobody reads any more.
    pub fn write_all(&self, bytes: &[u8]) -> bool {
        let block = [self.0, bytes.as_ptr().expose_provenance(), bytes.len()];
        // SAFETY: the operation reads the given length from the buffer, which is borrowed here.
        unsafe { syscall(nr::WRITE, &block) == 0 }
    }
}

/// The command line that the emulator was given; empty if it does not fit.
pub fn command_line(buffer: &mut [u8]) -> &str {
    let mut block = [buffer.as_mut_ptr().expose_provenance(), buffer.len()];
    let place = block.as_mut_ptr().expose_provenance();
    // SAFETY: the operation writes a terminated string of at most the given length into the buffer and its
    // length into the second word of the block. Both are alive, and exposed for it.
    let failed = unsafe { cortex_m_semihosting::syscall1(nr::GET_CMDLINE, place) } != 0;
    // SAFETY: the word is part of `block`, which is alive; volatile, because the emulator wrote it.
    let length = unsafe { (&raw const block[1]).read_volatile() };
    if failed {
        return "";
    }
    buffer
        .get(..length)
        .and_then(|bytes| str::from_utf8(bytes).ok())
        .unwrap_or_default()
}

/// Writes one line to the emulator's stderr, if it has one.
pub fn say(line: &str) {
    // The name for the console; the second handle opened for appending is stderr by Arm's convention.
    if let Some(stderr) = File::open_mode(":tt", nr::open::W_APPEND) {
        stderr.write_all(line.as_bytes());
        stderr.write_all(b"\n");
    }
}

/// Ends the emulator: exit code 0 or 1.
pub fn exit(well: bool) -> ! {
    loop {
        debug::exit(if well {
            debug::EXIT_SUCCESS
        } else {
            debug::EXIT_FAILURE
        });
    }
}
