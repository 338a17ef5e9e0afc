//! All tests of the models, in one binary. What counts allocations counts those of its own thread.

mod chainmail;
mod chainmail_forces;
mod energy_balance;
mod hyperelastic;
mod hyperelastic_orders;
mod hyperelastic_reference;
mod shape_matching;
