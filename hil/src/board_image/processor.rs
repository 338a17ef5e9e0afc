//! The processor under QEMU, stopped before every read of a watched register.
//!
//! Entry points: [`Processor::run`], [`Processor::pend`]. What a stop asks for is the [`Chip`]'s to answer.
//!
//! A thread that waits for its interrupts has a few instructions in the last bytes of RAM: the first one writes to the interrupt
//! controller, which the stub itself cannot, and the last one, reached when every handler is through, stops the processor.

use super::chip::{AIRCR, Chip, LOADER, RESET_REQUEST};
use super::connection::{Connection, PC, STATUS};
use super::error::BoardImageError;
use super::thumb::{self, Access};
use super::unimplemented::{Log, Logged};
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::path::PathBuf;
use std::time::Duration;

/// The chip's RAM.
const RAM: std::ops::Range<u32> = 0x2000_0000..0x2002_0000;
/// Where a thread waits, in the last bytes of RAM, which the image leaves alone: `str r1, [r0]`, branches to what follows, because QEMU
/// takes interrupts between blocks, which these are the ends of, and `ldr r1, [pc, #0]`.
const WAITING_ROOM: u32 = 0x2001_FFE0;
const WAITING_CODE: [u32; 4] = [0xE7FF_6001, 0xE7FF_E7FF, 0xE7FF_E7FF, 0xBF00_4900];
/// That load, and what it loads. It is watched: at a breakpoint QEMU would forget all that it has translated.
const SEAT: u32 = WAITING_ROOM + 12;
const LOADED: u32 = WAITING_ROOM + 16;

/// Polls of a crystal that never swings, after which the watchdog's time is up.
const CRYSTAL_POLLS: u32 = 200;
/// Accesses that an error tells of.
const KEPT: usize = 8;
/// Accesses that one stop does at most: those of two packets, or of a loop that waits.
const AT_A_STOP: usize = 64;

/// Why the processor has stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// Where a thread waits.
    Seat,
    /// Before a write to this register.
    Write(u32),
    /// At the first instruction of the loader in ROM.
    Loader,
    /// Before a read of it.
    Read(u32),
}

/// The processor, stopped.
#[derive(Debug)]
pub struct Processor {
    /// The emulator.
    pub connection: Connection,
    log: Log,
    /// Instructions that have been read, by place.
    code: HashMap<u32, [u16; 2]>,
    /// Places whose instructions are to be read with the next ones.
    unknown: BTreeSet<u32>,
    /// Read watches that are set.
    watched: BTreeSet<(u32, u32)>,
    /// Newest accesses.
    last: VecDeque<(u32, Option<u32>)>,
    /// Stops at reads so far.
    pub stops: u64,
    /// Instructions that were done in the processor's place so far.
    pub done: u32,
    /// A reset is on its way: its register is not watched until the image runs again.
    resets: bool,
}

impl Processor {
    /// Starts the emulator, before the image's first instruction.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn start(
        image: PathBuf,
        counts: bool,
        time_limit: Duration,
    ) -> Result<Processor, BoardImageError> {
        let mut connection = Connection::start(image, counts, time_limit)?;
        connection.put_read_watch((LOADED, 4), true);
        connection.watch_writes(AIRCR, true)?;
        for (at, word) in (WAITING_ROOM..).step_by(4).zip(WAITING_CODE) {
            connection.put_memory(at, 4, word);
        }
        Ok(Processor {
            log: Log::new(connection.log()),
            connection,
            code: HashMap::new(),
            unknown: BTreeSet::new(),
            watched: BTreeSet::new(),
            last: VecDeque::new(),
            stops: 0,
            done: 0,
            resets: false,
        })
    }

    /// Runs until a thread waits, until the chip is asked to reset, or until an access to `until`, whose writes or reads are watched.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if a watchdog's time is up, and others.
    pub fn run(&mut self, chip: &mut Chip, until: Option<u32>) -> Result<Stop, BoardImageError> {
        loop {
            self.set_watches(chip);
            self.resume(chip, false)?;
            if std::mem::take(&mut self.resets) {
                self.connection.watch_writes(AIRCR, true)?;
            }
            let registers = self.connection.registers()?;
            let pc = registers[PC];
            if pc == SEAT {
                return Ok(Stop::Seat);
            }
            if pc == LOADER.entry {
                return Ok(Stop::Loader);
            }
            self.stops += 1;
            let code = self.code(pc)?;
            let Some(access) = Access::decode(code, &integers(&registers)) else {
                return Err(BoardImageError::Instruction { pc, code });
            };
            let address = access.address;
            match access.load {
                false if address == AIRCR || Some(address) == until => {
                    return Ok(Stop::Write(address));
                }
                true if Some(address) == until => return Ok(Stop::Read(address)),
                _ => {}
            }
            self.go_on(chip, access, registers, until);
            if chip.waits_for_crystal > CRYSTAL_POLLS {
                return Err(match chip.watchdog_runs {
                    true => BoardImageError::Reset,
                    false => BoardImageError::Unguarded,
                });
            }
        }
    }

    /// One instruction, with interrupts held back; where it ends.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn step(&mut self, chip: &mut Chip) -> Result<u32, BoardImageError> {
        self.resume(chip, true)?;
        Ok(self.connection.registers()?[PC])
    }

    /// Has a thread that waits write to a register, and runs until it waits again.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if the image resets the chip, and others.
    pub fn pend(
        &mut self,
        chip: &mut Chip,
        register: u32,
        value: u32,
    ) -> Result<(), BoardImageError> {
        let registers = [(0, register), (1, value), (PC, WAITING_ROOM)];
        self.connection.put_registers(&registers);
        match self.run(chip, None)? {
            Stop::Seat => Ok(()),
            Stop::Write(_) => Err(BoardImageError::Reset),
            stop => Err(self.unexpected(stop)),
        }
    }

    /// Does the access that the processor has stopped before; its registers after that.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn access(&mut self, chip: &mut Chip) -> Result<Vec<u32>, BoardImageError> {
        let mut registers = self.connection.registers()?;
        let pc = registers[PC];
        let code = self.code(pc)?;
        let Some(access) = Access::decode(code, &integers(&registers)) else {
            return Err(BoardImageError::Instruction { pc, code });
        };
        self.carry_out(chip, &access, &mut registers);
        Ok(registers)
    }

    /// Has a thread that waits write to a register, and runs until the first read of another: the processor stands before it.
    ///
    /// # Errors
    /// [`BoardImageError::Stopped`] if it is not read, and others.
    pub fn pend_to_read(
        &mut self,
        chip: &mut Chip,
        (register, value): (u32, u32),
        until: u32,
    ) -> Result<(), BoardImageError> {
        let registers = [(0, register), (1, value), (PC, WAITING_ROOM)];
        self.connection.put_registers(&registers);
        match self.run(chip, Some(until))? {
            Stop::Read(_) => Ok(()),
            stop => Err(self.unexpected(stop)),
        }
    }

    /// Goes on with the access that the processor stands before, until a thread waits again.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if the image resets the chip, and others.
    pub fn go_on_to_rest(&mut self, chip: &mut Chip) -> Result<(), BoardImageError> {
        let registers = self.access(chip)?;
        self.connection.put_all_registers(&registers);
        match self.run(chip, None)? {
            Stop::Seat => Ok(()),
            Stop::Write(_) => Err(BoardImageError::Reset),
            stop => Err(self.unexpected(stop)),
        }
    }

    /// Has the chip reset itself, wherever the processor is; the next run begins at the image's first instruction.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn reset(&mut self) -> Result<(), BoardImageError> {
        if !std::mem::replace(&mut self.resets, true) {
            self.connection.watch_writes(AIRCR, false)?;
        }
        let registers = [(0, AIRCR), (1, RESET_REQUEST), (PC, WAITING_ROOM)];
        self.connection.put_registers(&registers);
        Ok(())
    }

    /// What to say of a processor that does not come to rest: where it is, and what it has used.
    pub fn circles(&mut self) -> BoardImageError {
        match self.connection.registers() {
            Ok(registers) => BoardImageError::Circles {
                pc: registers[PC],
                last: self.last_accesses(),
            },
            Err(error) => error,
        }
    }

    /// What to say of a stop that has no business there.
    pub fn unexpected(&self, stop: Stop) -> BoardImageError {
        BoardImageError::Stopped {
            at: format!("{stop:x?}"),
            last: self.last_accesses(),
        }
    }

    /// Does a load or store in the processor's place, and what comes right after it as long as that is loads of watched registers, stores
    /// to RAM, and what a loop has between them: how a packet leaves its FIFO.
    /// Not past an access to `until`.
    fn go_on(
        &mut self,
        chip: &mut Chip,
        first: Access,
        mut registers: Vec<u32>,
        until: Option<u32>,
    ) {
        let mut access = first;
        for _ in 0..AT_A_STOP {
            let status = registers[STATUS];
            self.carry_out(chip, &access, &mut registers);
            // Within an IT block what follows may not be executed.
            if registers[STATUS] != status {
                break;
            }
            match self.next_access(&mut registers) {
                Some(next) if Some(next.address) == until => break,
                Some(next) if next.load && self.is_watched(next.address) => access = next,
                Some(next) if !next.load && RAM.contains(&next.address) => access = next,
                _ => break,
            }
        }
        self.connection.put_all_registers(&registers);
    }

    /// Goes past what a loop has between its accesses; the access there, if one comes.
    fn next_access(&mut self, registers: &mut [u32]) -> Option<Access> {
        for _ in 0..AT_A_STOP {
            let code = self.known_code(registers[PC])?;
            if let Some(access) = Access::decode(code, &integers(registers)) {
                return Some(access);
            }
            if !thumb::go_past(code, registers) {
                return None;
            }
            self.done += 1;
        }
        None
    }

    /// One load or store, with what it does to the registers.
    fn carry_out(&mut self, chip: &mut Chip, access: &Access, registers: &mut [u32]) {
        let address = access.address;
        let value = registers[access.register];
        if access.load {
            self.note(address, None);
            registers[access.register] = access.loaded(chip.read(address));
        } else if RAM.contains(&address) {
            self.connection.put_memory(address, access.size, value);
        } else {
            self.note(address, Some(value));
            chip.write(address, access.loaded(value));
        }
        if let Some((base, value)) = access.write_back {
            registers[base] = value;
        }
        registers[PC] = registers[PC].wrapping_add(access.length);
        registers[STATUS] = thumb::past_it(registers[STATUS]);
        self.done += 1;
    }

    /// The instruction at a place, if it has been read; if not, it will be with the next one that has to be.
    fn known_code(&mut self, place: u32) -> Option<[u16; 2]> {
        let known = self.code.get(&place).copied();
        if known.is_none() {
            self.unknown.insert(place);
        }
        known
    }

    /// The instruction at a place.
    fn code(&mut self, place: u32) -> Result<[u16; 2], BoardImageError> {
        self.unknown.insert(place);
        for place in std::mem::take(&mut self.unknown) {
            if !self.code.contains_key(&place) {
                let word = self.connection.word(place)?;
                self.code.insert(place, [word as u16, (word >> 16) as u16]);
            }
        }
        Ok(self.code.get(&place).copied().unwrap_or_default())
    }

    fn is_watched(&self, address: u32) -> bool {
        let mut watched = self.watched.iter();
        watched.any(|(from, length)| (*from..from + length).contains(&address))
    }

    /// Sets the watches that the chip needs now, with the next run.
    fn set_watches(&mut self, chip: &Chip) {
        let wanted = chip.watched();
        for watch in self.watched.difference(&wanted) {
            self.connection.put_read_watch(*watch, false);
        }
        for watch in wanted.difference(&self.watched) {
            self.connection.put_read_watch(*watch, true);
        }
        self.watched = wanted;
    }

    /// Lets the processor go on, and takes what was logged until it stopped.
    fn resume(&mut self, chip: &mut Chip, one_step: bool) -> Result<(), BoardImageError> {
        let stops = self.connection.run(one_step)?;
        let logged = self.log.accesses();
        let logged = logged.map_err(|source| BoardImageError::Line {
            what: "QEMU's log cannot be read",
            source,
        })?;
        for Logged { address, written } in logged {
            self.note(address, written);
            match written {
                Some(value) => chip.write(address, value),
                None if chip.misread(address) => {
                    let value = chip.peek(address);
                    return Err(BoardImageError::Unwatched { address, value });
                }
                None => {}
            }
        }
        if stops { Ok(()) } else { Err(self.circles()) }
    }

    fn note(&mut self, address: u32, written: Option<u32>) {
        if self.last.len() >= KEPT {
            self.last.pop_front();
        }
        self.last.push_back((address, written));
    }

    fn last_accesses(&self) -> String {
        let text = |(address, written): &(u32, Option<u32>)| match written {
            Some(value) => format!("{address:#010x} = {value:#x}"),
            None => format!("{address:#010x} read"),
        };
        let last: Vec<_> = self.last.iter().map(text).collect();
        last.join(", ")
    }
}

fn integers(registers: &[u32]) -> [u32; 16] {
    std::array::from_fn(|at| registers.get(at).copied().unwrap_or(0))
}
