//! The emulator and its gdb stub: registers, memory and watches of a processor that stands.
//!
//! Entry points: [`Connection::start`], [`Connection::run`].

use super::error::BoardImageError;
use super::gdb::{Gdb, hex_word, words};
use crate::qemu::{self, Qemu, QemuOptions};
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// The image is said to run in circles when it has not stopped for so long. Only ever an error: nothing else depends on it.
const PATIENCE: Duration = Duration::from_secs(60);

/// Core registers as the stub numbers them.
pub const PC: usize = 15;
/// Status word, behind the core registers.
pub const STATUS: usize = 16;
/// The number that the stub gives the status word alone.
const STATUS_NUMBER: usize = 25;

/// An emulator that waits for a debugger, with one.
#[derive(Debug)]
pub struct Connection {
    gdb: Gdb,
    /// Bytes of RAM that wait to be written from an address on: each packet costs, so that what lies side by side shares one.
    stores: (u32, Vec<u8>),
    /// Dropped last: it ends the emulator.
    qemu: Qemu,
}

impl Connection {
    /// Starts the emulator, before the image's first instruction.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn start(
        image: PathBuf,
        counts: bool,
        time_limit: Duration,
    ) -> Result<Connection, BoardImageError> {
        check_version()?;
        stay_on_one_core();
        let qemu = Qemu::start(&QemuOptions {
            image,
            args: Vec::new(),
            icount: counts,
            uart: false,
            gdb: true,
            time_limit,
        })?;
        let gdb = connect(&qemu)?;
        let mut connection = Connection {
            gdb,
            stores: (0, Vec::new()),
            qemu,
        };
        // Without the target's description the stub does not give the status word.
        for packet in [
            "qSupported:xmlRegisters=arm",
            "qXfer:features:read:target.xml:0,ffb",
            "?",
        ] {
            connection.ask(packet)?;
        }
        Ok(connection)
    }

    /// What the emulator logs.
    pub fn log(&self) -> PathBuf {
        self.qemu.log()
    }

    /// Lets the processor run, or do one instruction with interrupts held back, until it stands again. What is queued
    /// comes before. False if it does not stop by itself; then it has been stopped.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn run(&mut self, one_step: bool) -> Result<bool, BoardImageError> {
        self.put(if one_step { "s" } else { "c" });
        let mut answers = match self.gdb.answers() {
            Ok(answers) => answers,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                let stopped = self.gdb.interrupt();
                return stopped.map(|_| false).map_err(|error| self.error(error));
            }
            Err(error) => return Err(self.error(error)),
        };
        // Of the stop itself the registers say more.
        answers.pop();
        match answers.into_iter().find(|answer| answer != "OK") {
            Some(answer) => Err(refused("a register, a word or a watch", answer)),
            None => Ok(true),
        }
    }

    /// Queues writes of registers, the status word among them.
    pub fn put_registers(&mut self, registers: &[(usize, u32)]) {
        for (at, value) in registers {
            let number = if *at == STATUS { STATUS_NUMBER } else { *at };
            self.put(&format!("P{number:x}={}", hex_word(*value)));
        }
    }

    /// Queues a write of all registers, as [`Connection::registers`] has them.
    pub fn put_all_registers(&mut self, registers: &[u32]) {
        let digits: String = registers.iter().map(|value| hex_word(*value)).collect();
        self.put(&format!("G{digits}"));
    }

    /// Queues a write of 1, 2 or 4 bytes of RAM.
    pub fn put_memory(&mut self, address: u32, size: u32, value: u32) {
        let (from, bytes) = &self.stores;
        if from.wrapping_add(bytes.len() as u32) != address {
            self.put_stores();
            self.stores.0 = address;
        }
        let bytes = value.to_le_bytes();
        self.stores.1.extend(bytes.iter().take(size as usize));
    }

    /// Queues what waits to be written to RAM.
    fn put_stores(&mut self) {
        let (address, bytes) = &mut self.stores;
        if !bytes.is_empty() {
            let digits: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
            let length = bytes.len();
            self.gdb.put(&format!("M{address:x},{length:x}:{digits}"));
            *address = address.wrapping_add(length as u32);
            bytes.clear();
        }
    }

    /// Queues a packet.
    fn put(&mut self, packet: &str) {
        self.put_stores();
        self.gdb.put(packet);
    }

    /// Queues a watch of reads, or its end.
    pub fn put_read_watch(&mut self, (address, length): (u32, u32), on: bool) {
        self.put(&format!("{}3,{address:x},{length:x}", letter(on)));
    }

    /// r0 to r15 and the status word.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn registers(&mut self) -> Result<Vec<u32>, BoardImageError> {
        let answer = self.ask("g")?;
        let registers = words(&answer);
        if registers.len() > STATUS {
            Ok(registers)
        } else {
            Err(refused("g", answer))
        }
    }

    /// A word of memory, or of a register that QEMU has.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn word(&mut self, address: u32) -> Result<u32, BoardImageError> {
        let packet = format!("m{address:x},4");
        let answer = self.ask(&packet)?;
        let word = words(&answer).first().copied();
        word.ok_or_else(|| refused(&packet, answer))
    }

    /// Bytes of memory.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn memory(&mut self, address: u32, length: u32) -> Result<Vec<u8>, BoardImageError> {
        let packet = format!("m{address:x},{length:x}");
        let answer = self.ask(&packet)?;
        let bytes: Vec<u8> = words(&answer)
            .into_iter()
            .flat_map(u32::to_le_bytes)
            .collect();
        if bytes.len() == length as usize {
            Ok(bytes)
        } else {
            Err(refused(&packet, answer))
        }
    }

    /// Stops before writes to a register from now on, or no longer.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn watch_writes(&mut self, address: u32, on: bool) -> Result<(), BoardImageError> {
        self.command(&format!("{}2,{address:x},4", letter(on)))
    }

    /// Stops before the instruction at a place from now on, or no longer.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn break_at(&mut self, place: u32, on: bool) -> Result<(), BoardImageError> {
        self.command(&format!("{}1,{place:x},2", letter(on)))
    }

    fn command(&mut self, packet: &str) -> Result<(), BoardImageError> {
        match self.ask(packet)? {
            answer if answer == "OK" => Ok(()),
            answer => Err(refused(packet, answer)),
        }
    }

    fn ask(&mut self, packet: &str) -> Result<String, BoardImageError> {
        self.put_stores();
        let answer = self.gdb.ask(packet);
        answer.map_err(|error| self.error(error))
    }

    /// An error of the line: most likely the emulator has ended, and says why.
    fn error(&self, source: io::Error) -> BoardImageError {
        if self.qemu.is_running() && source.kind() != io::ErrorKind::UnexpectedEof {
            let what = "the line to QEMU's gdb stub";
            BoardImageError::Line { what, source }
        } else {
            self.qemu.ending().into()
        }
    }
}

/// Keeps this thread, and what it starts, on the core where it is. It and the emulator only ever wait for each other: waking the
/// other one on the same core costs half as much as on another, above all if that has gone to sleep.
fn stay_on_one_core() {
    #[cfg(target_os = "linux")]
    {
        let mut core = rustix::thread::CpuSet::new();
        core.set(rustix::thread::sched_getcpu());
        // A system that forbids it has them slower, not wrong.
        let _ = rustix::thread::sched_setaffinity(None, &core);
    }
}

fn letter(on: bool) -> char {
    if on { 'Z' } else { 'z' }
}

fn refused(packet: &str, answer: String) -> BoardImageError {
    BoardImageError::Refused {
        packet: packet.to_owned(),
        answer,
    }
}

/// Connects to the stub as soon as it is there.
fn connect(qemu: &Qemu) -> Result<Gdb, BoardImageError> {
    use io::ErrorKind::{ConnectionRefused, NotFound};
    let path = qemu.gdb();
    loop {
        match Gdb::connect(&path, PATIENCE) {
            Ok(gdb) => return Ok(gdb),
            Err(_) if !qemu.is_running() => return Err(qemu.ending().into()),
            Err(error) if matches!(error.kind(), NotFound | ConnectionRefused) => {
                std::thread::sleep(Duration::from_millis(5));
            }
            Err(source) => {
                let what = "QEMU's gdb stub cannot be reached";
                return Err(BoardImageError::Line { what, source });
            }
        }
    }
}

/// Versions of QEMU whose log is known.
const KNOWN: std::ops::Range<(u32, u32)> = (7, 2)..(9, 0);

fn check_version() -> Result<(), BoardImageError> {
    let found = qemu::version()?;
    match parse_version(&found) {
        Some(version) if KNOWN.contains(&version) => Ok(()),
        _ => Err(BoardImageError::Version {
            program: qemu::PROGRAM,
            found,
        }),
    }
}

/// `QEMU emulator version 7.2.22 (Debian ...)`.
fn parse_version(text: &str) -> Option<(u32, u32)> {
    let (_, after) = text.split_once("version ")?;
    let mut numbers = after.split(['.', ' ']);
    let mut number = || numbers.next()?.parse().ok();
    Some((number()?, number()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_that_log_otherwise_are_refused() {
        let is_known = |text: &str| parse_version(text).is_some_and(|v| KNOWN.contains(&v));
        assert!(is_known(
            "QEMU emulator version 7.2.22 (Debian 1:7.2+dfsg-7)"
        ));
        assert!(is_known("QEMU emulator version 8.2.2 (Debian 1:8.2.2+ds)"));
        for other in [
            "QEMU emulator version 6.2.0",
            "QEMU emulator version 10.0.1",
            "hello",
        ] {
            assert!(!is_known(other), "{other}");
        }
    }
}
