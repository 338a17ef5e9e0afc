//! The processor under QEMU, stopped before every read of a watched register.
//!
//! Entry points: [`Processor::run`], [`Processor::pend`]. What a stop asks for is the [`Chip`]'s to answer.
//!
//! A thread that waits for its interrupts has a few instructions in the last bytes of RAM: the first one writes to the interrupt
//! controller, which the stub itself cannot, and the last one, reached when every handler is through, stops the processor.

use super::between;
use super::chip::{AIRCR, Chip, LOADER, RESET_REQUEST, WWDG_CR};
use super::connection::{Connection, PC, STATUS};
use super::error::BoardImageError;
use super::thumb::{self, Access};
use super::unimplemented::{Log, Logged, is_lacking};
use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::path::PathBuf;
use std::time::Duration;

/// The chip's flash, and its RAM.
const FLASH: std::ops::Range<u32> = 0x0800_0000..0x0810_0000;
const RAM: std::ops::Range<u32> = 0x2000_0000..0x2002_0000;
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
/// Accesses that one stop does at most: those of two packets, or of a loop that waits; and instructions between two of them.
const AT_A_STOP: usize = 256;
const BETWEEN: usize = 64;
/// Stops at a place that have spared none, after which nobody looks for more there.
const NOWHERE: i32 = -4;
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
    /// Lines of RAM that have been read at this stop.
    ram: HashMap<u32, Vec<u8>>,
    /// Places of accesses: how often more followed them at a stop, less how often none did.
    leads_on: HashMap<u32, i32>,
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
            ram: HashMap::new(),
            leads_on: HashMap::new(),
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
            self.go_on(chip, access, registers, until)?;
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
        self.carry_out(chip, &access, &mut registers)?;
        Ok(registers)
    }

    /// Has the processor do instructions one at a time from where it stands, and compares what each does with what would have been done in its
    /// place; how many of them would have been.
    ///
    /// # Errors
    /// [`BoardImageError::Differs`] if one does something else, and others.
    pub fn compare(&mut self, chip: &mut Chip, count: usize) -> Result<usize, BoardImageError> {
        let mut compared = 0;
        let mut registers = self.connection.registers()?;
        for _ in 0..count {
            let pc = registers[PC];
            let code = self.code(pc)?;
            let mut here = registers.clone();
            let access = Access::decode(code, &integers(&registers));
            let is_own = match access {
                _ if between::is_in_it(&registers) => false,
                Some(access) if access.load && RAM.contains(&access.address) => {
                    self.carry_out(chip, &access, &mut here)?;
                    true
                }
                _ => between::go_past(code, &mut here),
            };
            let after = self.step_from(chip, pc)?;
            if is_own && here != after {
                return Err(BoardImageError::Differs {
                    pc,
                    code,
                    here,
                    after,
                });
            }
            compared += usize::from(is_own);
            registers = after;
        }
        Ok(compared)
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

    /// Does a load or store in the processor's place, and what comes after it, as long as that is accesses to what QEMU lacks and to RAM, and
    /// instructions that touch no memory. Not past an access to `until`.
    fn go_on(
        &mut self,
        chip: &mut Chip,
        first: Access,
        mut registers: Vec<u32>,
        until: Option<u32>,
    ) -> Result<(), BoardImageError> {
        let place = registers[PC];
        let status = registers[STATUS];
        self.carry_out(chip, &first, &mut registers)?;
        let leads_on = self.leads_on.get(&place).copied().unwrap_or(0);
        // Within an IT block what follows may not be executed.
        if registers[STATUS] == status && leads_on > NOWHERE {
            let mut spared = false;
            for _ in 0..AT_A_STOP {
                let Some(next) = self.next_access(&mut registers)? else {
                    break;
                };
                if Some(next.address) == until || !self.can_do(chip, &next) {
                    break;
                }
                spared |= next.load && self.is_watched(next.address);
                self.carry_out(chip, &next, &mut registers)?;
            }
            let by = if spared { 1 } else { -1 };
            self.leads_on.insert(place, (leads_on + by).min(-NOWHERE));
        }
        self.connection.put_all_registers(&registers);
        Ok(())
    }

    /// Whether an access is to RAM or to what QEMU lacks; where it would read 0, that is what is there.
    fn can_do(&self, chip: &Chip, access: &Access) -> bool {
        let address = access.address;
        match access.load {
            _ if RAM.contains(&address) => true,
            true if self.is_watched(address) => true,
            true => is_lacking(address) && chip.peek(address) == 0,
            false => is_lacking(address),
        }
    }

    /// Goes past what touches no memory; the access there, if one comes.
    fn next_access(&mut self, registers: &mut [u32]) -> Result<Option<Access>, BoardImageError> {
        for _ in 0..BETWEEN {
            let code = self.code(registers[PC])?;
            if between::go_past(code, registers) {
                self.done += 1;
            } else if between::is_in_it(registers) {
                break;
            } else {
                return Ok(Access::decode(code, &integers(registers)));
            }
        }
        Ok(None)
    }

    /// One load or store, with what it does to the registers.
    fn carry_out(
        &mut self,
        chip: &mut Chip,
        access: &Access,
        registers: &mut [u32],
    ) -> Result<(), BoardImageError> {
        let address = access.address;
        let value = registers[access.register];
        let in_ram = RAM.contains(&address);
        match access.load {
            true if in_ram => {
                let word = self.ram(address, access.size)?;
                registers[access.register] = access.loaded(word);
            }
            true => {
                self.note(address, None);
                registers[access.register] = access.loaded(chip.read(address));
            }
            false if in_ram => self.put_ram(address, access.size, value),
            false => {
                self.note(address, Some(value));
                chip.write(address, access.loaded(value));
            }
        }
        if let Some((base, value)) = access.write_back {
            registers[base] = value;
        }
        registers[PC] = registers[PC].wrapping_add(access.length);
        registers[STATUS] = thumb::past_it(registers[STATUS]);
        self.done += 1;
        Ok(())
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

    /// What is in RAM, of 1, 2 or 4 bytes.
    fn ram(&mut self, address: u32, size: u32) -> Result<u32, BoardImageError> {
        let mut bytes = [0; 4];
        for (at, byte) in (address..address + size).zip(&mut bytes) {
            let line = match self.ram.entry(at / LINE) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(self.connection.memory(at / LINE * LINE, LINE)?),
            };
            *byte = line.get((at % LINE) as usize).copied().unwrap_or(0);
        }
        Ok(u32::from_le_bytes(bytes))
    }

    /// Queues a store to RAM.
    fn put_ram(&mut self, address: u32, size: u32, value: u32) {
        self.connection.put_memory(address, size, value);
        for (at, byte) in (address..address + size).zip(value.to_le_bytes()) {
            let line = self.ram.get_mut(&(at / LINE));
            if let Some(place) = line.and_then(|line| line.get_mut((at % LINE) as usize)) {
                *place = byte;
            }
        }
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
        self.stood_at = None;
        self.ram.clear();
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
