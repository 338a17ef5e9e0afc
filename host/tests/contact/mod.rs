//! Rigid tools on tissue: balance, exact tangents, rows, bad poses, same bits.

mod balance;
mod bars;
mod bench;
mod corotational;
mod deep;
mod friction;
mod hyperelastic;
mod jacobian;
mod meshes;
mod poses;
mod punch;
mod renewal;
mod rows;
mod small;
mod sunk;
mod swept;
mod tools;
mod walls;
mod worker;
