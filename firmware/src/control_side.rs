//! One control tick with everything around it that is not the shared code's: what the control task runs.
//!
//! Entry point: [`ControlSide::tick`]. Nothing here waits, allocates or logs.

use crate::exchange::Exchange;
use crate::host_side::{Costs, Order, OrdersOut, Sample, Slot};
use sutura_shared::control::{Control, TickInput, TickOutput};
use sutura_shared::wire::ValidSimulate;

/// Encoders, motors and switches of a console, real or simulated.
pub trait Plant {
    /// Reads the inputs of this tick; `overrun`: the last one took longer than its period.
    fn read(&mut self, overrun: bool) -> TickInput;
    /// Commands the motors.
    fn write(&mut self, output: &TickOutput);
    /// Whether this tick has taken longer than its period by now.
    fn overrun(&self) -> bool;
    /// An order to a simulated console; a real one never gets any.
    fn simulate(&mut self, order: &ValidSimulate, control: &mut Control);
}

/// The control loop and the ends of what leads to it.
pub struct ControlSide<'a, P> {
    control: Control,
    plant: P,
    orders: OrdersOut<'a>,
    front: &'a mut Slot,
    fresh: bool,
    sample: &'a mut Sample,
    overrun: bool,
    costs: Costs,
}

impl<'a, P: Plant> ControlSide<'a, P> {
    /// `front`: the reader's buffer of the exchange of contacts; `sample`: the writer's of the other one.
    pub fn new(
        control: Control,
        plant: P,
        orders: OrdersOut<'a>,
        front: &'a mut Slot,
        sample: &'a mut Sample,
    ) -> Self {
        Self { control, plant, orders, front, fresh: false, sample, overrun: false, costs: Costs::default() }
    }

    /// Takes the newest contact, if there is one. Under the lock: one swap.
    pub fn take(&mut self, contacts: &mut Exchange<'a, Slot>) {
        self.fresh = contacts.take(&mut self.front);
    }

    /// Runs one tick and returns its console time \[us\].
    pub fn tick(&mut self) -> u64 {
        while let Some(order) = self.orders.dequeue() {
            match order {
                Order::OpenSession => self.control.open_session(),
                Order::Command(command) => self.control.command(command),
                Order::Simulate(order) => self.plant.simulate(&order, &mut self.control),
            }
        }
        let input = self.plant.read(self.overrun);
        let fresh = if self.fresh { self.front.as_ref() } else { None };
        let output = self.control.tick(&input, fresh);
        self.plant.write(&output);
        self.overrun = self.plant.overrun();
        *self.sample = Sample { now_us: input.now_us, state: output.state, costs: self.costs };
        input.now_us
    }

    /// Hands the tick's outcome over. Under the lock: one swap.
    pub fn give(&mut self, samples: &mut Exchange<'a, Sample>) {
        samples.publish(&mut self.sample);
    }

    /// Counts what the tick cost, in the board's unit; to be called after everything else.
    pub fn finish(&mut self, cost: u32) {
        self.costs.overruns = self.costs.overruns.wrapping_add(u32::from(self.overrun));
        self.costs.cost_max = self.costs.cost_max.max(cost);
    }
}
