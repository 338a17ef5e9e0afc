//! The processor under QEMU, stopped before every read of a watched register.
//!
//! Entry points: [`Processor::run`], [`Processor::pend`]. What a stop asks for is the [`Chip`]'s to answer.
//!
//! A thread that waits for its interrupts has a few instructions in the last bytes of RAM: the first one writes to the interrupt
//! controller, which the stub itself cannot, and the last one, reached when every handler is through, stops the processor.

use super::chip::{AIRCR, Chip, LOADER, RESET_REQUEST, WWDG_CR};
use super::connection::{Connection, PC, STATUS};
use super::error::BoardImageError;
use super::thumb::{self, Access};
use super::unimplemented::{Log, Logged};
use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::path::PathBuf;
use std::time::Duration;

/// The chip's flash.
const FLASH: std::ops::Range<u32> = 0x0800_0000..0x0810_0000;
/// Where a thread waits, in the last bytes of RAM, which the image leaves alone: `str r1, [r0]`, branches to what follows, because QEMU
/// takes interrupts between blocks, which these are the ends of, and `ldr r1, [pc, #0]`.
const WAITING_ROOM: u32 = 0x2001_FFE0;
const WAITING_CODE: [u32; 4] = [0xE7FF_6001, 0xE7FF_E7FF, 0xE7FF_E7FF, 0xBF00_4900];
/// That load, and what it loads. It is watched: at a breakpoint QEMU would forget all that it has translated.
const SEAT: u32 = WAITING_ROOM + 12;
const LOADED: u32 = WAITING_ROOM + 16;

/// Polls of a crystal that never swings, or of a supply that stays low, after which the watchdog's time is up.
const MOST_POLLS: u32 = 200;
/// Accesses that an error tells of.
const KEPT: usize = 8;
/// Bytes of memory that are read together.
const LINE: u32 = 64;

/// Why the processor has stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// Where a thread waits.
    Seat,
    /// Before a write to this register.
    Write(u32),
    /// At the first instruction of the loader in ROM.
    Loader,
    /// Where [`Processor::stands_at`] says.
    Place,
    /// Before a read of it.
    Read(u32),
}

/// The processor, stopped.
#[derive(Debug)]
pub struct Processor {
    /// The emulator.
    pub connection: Connection,
    log: Log,
    /// Lines of flash that have been read.
    code: HashMap<u32, Vec<u8>>,
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
    /// Where the processor is to stand, before the instruction there.
    pub stands_at: Option<u32>,
    /// Registers at the last stop, as long as nobody has changed any.
    stood_at: Option<Vec<u32>>,
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
        connection.watch_writes(WWDG_CR, true)?;
        for (at, word) in (WAITING_ROOM..).step_by(4).zip(WAITING_CODE) {
            connection.put_memory(at, 4, word);
        }
        Ok(Processor {
            log: Log::new(connection.log()),
            connection,
            code: HashMap::new(),
            watched: BTreeSet::new(),
            last: VecDeque::new(),
            stops: 0,
            done: 0,
            resets: false,
            stands_at: None,
            stood_at: None,
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
                self.stood_at = Some(registers);
                return Ok(Stop::Seat);
            }
            if pc == LOADER.entry {
                return Ok(Stop::Loader);
            }
            if Some(pc) == self.stands_at {
                self.stood_at = Some(registers);
                return Ok(Stop::Place);
            }
            self.stops += 1;
            let code = self.code(pc)?;
            let Some(access) = Access::decode(code, &integers(&registers)) else {
                return Err(BoardImageError::Instruction { pc, code });
            };
            let address = access.address;
            match access.load {
                false if address == AIRCR || Some(address) == until => {
                    self.stood_at = Some(registers);
                    return Ok(Stop::Write(address));
                }
                true if Some(address) == until => {
                    self.stood_at = Some(registers);
                    return Ok(Stop::Read(address));
                }
                _ => {}
            }
            let mut registers = registers;
            self.carry_out(chip, &access, &mut registers);
            self.connection.put_all_registers(&registers);
            if chip.waits > MOST_POLLS {
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
        self.put_registers(&[(0, register), (1, value), (PC, WAITING_ROOM)]);
        match self.run(chip, None)? {
            Stop::Seat => Ok(()),
            Stop::Write(_) => Err(BoardImageError::Reset),
            stop => Err(self.unexpected(stop)),
        }
    }

    /// Queues a write of registers before the next run. One packet, if what they all are is known.
    pub fn put_registers(&mut self, changed: &[(usize, u32)]) {
        let Some(mut registers) = self.stood_at.take() else {
            return self.connection.put_registers(changed);
        };
        for (at, value) in changed {
            registers[*at] = *value;
        }
        self.connection.put_all_registers(&registers);
    }

    /// Queues a write of all registers, as [`Processor::access`] has left them.
    pub fn put_registers_after(&mut self, registers: &[u32]) {
        self.stood_at = None;
        self.connection.put_all_registers(registers);
    }

    /// Does the access that the processor has stopped before; its registers after that.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn access(&mut self, chip: &mut Chip) -> Result<Vec<u32>, BoardImageError> {
        let mut registers = match &self.stood_at {
            Some(registers) => registers.clone(),
            None => self.connection.registers()?,
        };
        let pc = registers[PC];
        let code = self.code(pc)?;
        let Some(access) = Access::decode(code, &integers(&registers)) else {
            return Err(BoardImageError::Instruction { pc, code });
        };
        self.carry_out(chip, &access, &mut registers);
        Ok(registers)
    }

    /// Has the processor do instructions one at a time from where it stands, until it has done this one.
    ///
    /// # Errors
    /// [`BoardImageError::Circles`] if that is none of the next `most`, and others.
    pub fn step_past(
        &mut self,
        chip: &mut Chip,
        instruction: u16,
        most: usize,
    ) -> Result<(), BoardImageError> {
        let mut registers = self.connection.registers()?;
        for _ in 0..most {
            let pc = registers[PC];
            let code = self.code(pc)?;
            registers = self.step_from(chip, pc)?;
            if code[0] == instruction {
                return Ok(());
            }
        }
        Err(self.circles())
    }

    /// One instruction, that at `pc`, with interrupts held back, and with the access if it is one that is watched; the registers after it.
    fn step_from(&mut self, chip: &mut Chip, pc: u32) -> Result<Vec<u32>, BoardImageError> {
        self.resume(chip, true)?;
        let after = self.connection.registers()?;
        let code = self.code(pc)?;
        if after[PC] != pc || Access::decode(code, &integers(&after)).is_none() {
            return Ok(after);
        }
        let after = self.access(chip)?;
        self.put_registers_after(&after);
        Ok(after)
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
        self.put_registers(&[(0, register), (1, value), (PC, WAITING_ROOM)]);
        match self.run(chip, Some(until))? {
            Stop::Read(_) => Ok(()),
            stop => Err(self.unexpected(stop)),
        }
    }

    /// Has a thread that waits write to a register, and runs until the instruction at a place: the processor stands before it.
    ///
    /// # Errors
    /// [`BoardImageError::Stopped`] if it does not come there, and others.
    pub fn pend_to_place(
        &mut self,
        chip: &mut Chip,
        (register, value): (u32, u32),
        place: u32,
    ) -> Result<(), BoardImageError> {
        self.put_registers(&[(0, register), (1, value), (PC, WAITING_ROOM)]);
        self.connection.break_at(place, true)?;
        self.stands_at = Some(place);
        let stop = self.run(chip, None);
        self.stands_at = None;
        let stop = stop?;
        self.connection.break_at(place, false)?;
        match stop {
            Stop::Place => Ok(()),
            stop => Err(self.unexpected(stop)),
        }
    }

    /// Goes on with the access that the processor stands before, until a thread waits again.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if the image resets the chip, and others.
    pub fn go_on_to_rest(&mut self, chip: &mut Chip) -> Result<(), BoardImageError> {
        let registers = self.access(chip)?;
        self.put_registers_after(&registers);
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
        self.put_registers(&[(0, AIRCR), (1, RESET_REQUEST), (PC, WAITING_ROOM)]);
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

    /// One load or store, with what it does to the registers.
    fn carry_out(&mut self, chip: &mut Chip, access: &Access, registers: &mut [u32]) {
        let address = access.address;
        if access.load {
            self.note(address, None);
            registers[access.register] = access.loaded(chip.read(address));
        } else {
            let value = registers[access.register];
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

    /// The instruction at a place.
    fn code(&mut self, place: u32) -> Result<[u16; 2], BoardImageError> {
        if !FLASH.contains(&place) {
            let word = self.connection.word(place)?;
            return Ok([word as u16, (word >> 16) as u16]);
        }
        let mut bytes = [0; 4];
        for (at, byte) in (place..).zip(&mut bytes) {
            let line = match self.code.entry(at / LINE) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(self.connection.memory(at / LINE * LINE, LINE)?),
            };
            *byte = line.get((at % LINE) as usize).copied().unwrap_or(0);
        }
        let [a, b, c, d] = bytes;
        Ok([u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d])])
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
        self.stood_at = None;
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
