//! A whole console in software: link, control and virtual device, put together in the order in which
//! the firmware's tasks run.
//!
//! Entry points: [`SimulatedConsole`] where one thread does everything; [`SimulatedBoard`] for firmware
//! that runs link and control in tasks of its own, as a board has encoders and motors.

use crate::console_endpoint::{ConsoleEndpoint, Costs, Delivery, Sample};
use crate::control::{Control, Fresh, TICK_HZ, TICK_US, TickInput, TickOutput, Tuning};
use crate::device::{DeviceDescription, DeviceError};
use crate::link::{Checks, ConsoleLink, Counters, Identity};
use crate::virtual_console::VirtualDevice;
use crate::wire::message::{Report, Simulate};

/// What a simulated console has in the place of a board: encoders, motors, and an emergency stop.
#[derive(Clone, Copy, Debug)]
pub struct SimulatedBoard {
    device: VirtualDevice,
    emergency_stop: bool,
    now_us: u64,
}

impl SimulatedBoard {
    /// A board at boot.
    pub fn new(device: &DeviceDescription) -> Self {
        SimulatedBoard {
            device: VirtualDevice::new(device),
            emergency_stop: false,
            now_us: 0,
        }
    }

    /// A board that has been up for so long \[us\].
    pub fn at(device: &DeviceDescription, now_us: u64) -> Self {
        SimulatedBoard {
            now_us,
            ..SimulatedBoard::new(device)
        }
    }

    /// Obeys an order to the simulation. The device changes only while the amplifiers are off and no fault
    /// is latched; while they are on, a new hand takes the grip where it is.
    pub fn simulate(&mut self, order: &Simulate, control: &mut Control) {
        match order {
            Simulate::Device(device) => {
                if control.change_device(device) {
                    self.device = VirtualDevice::new(device);
                }
            }
            Simulate::Hand(script) => {
                if control.restart_encoders() {
                    self.device.place(&script.start_joint);
                }
                self.device.set_hand(script);
            }
            Simulate::EmergencyStop(pressed) => self.emergency_stop = *pressed,
            Simulate::EncoderOffset(counts) => self.device.set_encoder_offset(*counts),
        }
    }

    /// Starts a tick and reads its inputs. `overrun`: the tick before took longer than its period.
    pub fn read(&mut self, overrun: bool) -> TickInput {
        self.now_us += TICK_US;
        TickInput {
            now_us: self.now_us,
            encoder_counts: self.device.encoder_counts(),
            emergency_stop: self.emergency_stop,
            overrun,
            ..TickInput::default()
        }
    }

    /// Lets the device move until the next tick.
    pub fn write(&mut self, output: &TickOutput) {
        self.device
            .advance(&output.current_a, output.amplifiers_on, TICK_US as u32);
    }

    /// The mechanics.
    pub fn device(&self) -> &VirtualDevice {
        &self.device
    }

    /// Console time of the last tick \[us\].
    pub fn now_us(&self) -> u64 {
        self.now_us
    }
}

/// Guards and checks that a simulated console goes without, to see what they are for. No console with motors reads this.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Without {
    /// Of the control loop.
    pub tuning: Tuning,
    /// Of the link.
    pub checks: Checks,
}

impl Without {
    /// Switches off what has this name, see [`Guards::switch_off`](crate::control::Guards::switch_off) and
    /// [`Checks::switch_off`]; false if nothing has.
    pub fn switch_off(&mut self, name: &str) -> bool {
        self.tuning.guards.switch_off(name) || self.checks.switch_off(name)
    }
}

/// How punctual the thread that runs a console was with the last tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pace {
    /// Its computation took longer than its period.
    pub overrun: bool,
    /// It started more than a period late.
    pub late: bool,
}

/// A console in one thread.
#[derive(Clone, Debug)]
pub struct SimulatedConsole {
    endpoint: ConsoleEndpoint,
    control: Control,
    board: SimulatedBoard,
    contact: Option<Fresh>,
    costs: Costs,
    /// Of a tick that has not been sent yet.
    sample: Option<Sample>,
    /// Time since the last tick \[us\].
    since_tick_us: u64,
}

impl SimulatedConsole {
    /// A console at boot. `seed`: see [`ConsoleLink::new`].
    ///
    /// # Errors
    /// See [`DeviceDescription::validate`].
    pub fn new(device: &DeviceDescription, seed: u32) -> Result<SimulatedConsole, DeviceError> {
        SimulatedConsole::tuned(device, seed, Tuning::default(), Checks::ALL)
    }

    /// A console with a rendering, or without some guards and checks: to measure what they are for, and whether a test
    /// would notice. Nothing on the wire reaches this.
    ///
    /// # Errors
    /// See [`DeviceDescription::validate`].
    pub fn tuned(
        device: &DeviceDescription,
        seed: u32,
        tuning: Tuning,
        checks: Checks,
    ) -> Result<SimulatedConsole, DeviceError> {
        let identity = Identity {
            tick_hz: TICK_HZ,
            simulated: true,
            device_name: device.name,
        };
        let link = ConsoleLink::with_checks(identity, seed, checks);
        Ok(SimulatedConsole {
            endpoint: ConsoleEndpoint::new(link, Report::default()),
            control: Control::tuned(*device, tuning)?,
            board: SimulatedBoard::new(device),
            contact: None,
            costs: Costs::default(),
            sample: None,
            since_tick_us: 0,
        })
    }

    /// Says how long ago the last tick was due \[us\], where a clock runs between ticks; else that is 0. What comes
    /// in and what goes out is stamped with it.
    pub fn wait(&mut self, since_tick_us: u64) {
        self.since_tick_us = since_tick_us;
    }

    /// The console's clock \[us\].
    fn clock_us(&self) -> u64 {
        self.board.now_us() + self.since_tick_us
    }

    /// Takes bytes from the host.
    pub fn feed(&mut self, bytes: &[u8]) {
        self.expire();
        let now_us = self.clock_us();
        let mut rest = bytes;
        while let Some(delivery) = self.endpoint.receive(&mut rest, now_us) {
            self.apply(delivery);
        }
    }

    /// Closes a session in which nothing comes.
    fn expire(&mut self) {
        if let Some(delivery) = self.endpoint.expire(self.board.now_us()) {
            self.apply(delivery);
        }
    }

    fn apply(&mut self, delivery: Delivery) {
        match delivery {
            Delivery::Contact(contact) => {
                let fresh = self.endpoint.fresh(contact);
                if self.contact.replace(fresh).is_some() {
                    self.endpoint.count_superseded();
                }
            }
            Delivery::Order(order) => {
                if order.voids_contacts() {
                    self.contact = None;
                }
                let board = &mut self.board;
                order.obey(&mut self.control, |order, control| {
                    board.simulate(order, control);
                });
            }
        }
    }

    /// Runs one tick. `pace` is that of the tick before.
    pub fn tick(&mut self, pace: Pace) -> TickOutput {
        self.expire();
        self.since_tick_us = 0;
        let input = self.board.read(pace.overrun);
        let output = self.control.tick(&input, self.contact.take().as_ref());
        self.board.write(&output);
        count(&mut self.costs.overruns, pace.overrun);
        count(&mut self.costs.late, pace.late);
        self.sample = Some(Sample {
            now_us: input.now_us,
            state: output.state,
            costs: self.costs,
        });
        output
    }

    /// Gives what is to be sent after a tick, in order: the answer to a `Hello`, `State`, `Pong`, `Report`.
    pub fn drain(&mut self, out: &mut impl Extend<u8>) {
        let clock_us = self.clock_us();
        let mut push = |frame: &[u8]| out.extend(frame.iter().copied());
        match self.sample.take() {
            Some(sample) => {
                self.endpoint.send(&sample, clock_us, push);
            }
            None => self.endpoint.reply(self.board.now_us(), &mut push),
        }
    }

    /// Control rate \[Hz\].
    pub fn tick_hz(&self) -> u16 {
        TICK_HZ
    }

    /// What the link has counted.
    pub fn counters(&self) -> Counters {
        self.endpoint.link().counters()
    }

    /// The control loop, to look at.
    pub fn control(&self) -> &Control {
        &self.control
    }

    /// The board, to look at.
    pub fn board(&self) -> &SimulatedBoard {
        &self.board
    }
}

fn count(counter: &mut u32, happened: bool) {
    *counter = counter.wrapping_add(u32::from(happened));
}
