//! What hosts without a mesh solve, in closed form: a push, a wall, a ball.
//!
//! Entry point: [`solver`].

use super::World;
use sutura_host::session::{Solve, Solved};
use sutura_host::step::{Status, ToolContact};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// Force and tangent at a place.
struct Analytic(World);

/// The solver of a world without a mesh.
pub(super) fn solver(world: &World) -> Box<dyn Solve> {
    Box::new(Analytic(world.clone()))
}

impl Analytic {
    fn contact(&self, place: [f64; 3]) -> ToolContact {
        let mut contact = ToolContact {
            normal: [0.0, 0.0, 1.0],
            ..ToolContact::default()
        };
        let (stiffness, radius, from) = match self.0 {
            World::Push(force) => {
                contact.wrench[2] = force;
                return contact;
            }
            World::Wall(stiffness) => (stiffness, 0.0, [0.0, 0.0, place[2]]),
            World::Ball(stiffness, radius) => (stiffness, radius, place),
            World::Nobody | World::Tissue(_) => return contact,
        };
        let distance = from.iter().map(|x| x * x).sum::<f64>().sqrt();
        // A wall has an inside: below it the way out is up all the same.
        let (normal, height) = match self.0 {
            World::Wall(_) => ([0.0, 0.0, 1.0], place[2]),
            _ if distance > 1e-9 => (from.map(|x| x / distance), distance - radius),
            _ => ([0.0, 0.0, 1.0], -radius),
        };
        let push = stiffness * (-height).max(0.0);
        contact.normal = normal;
        contact.gap_m = height.max(0.0);
        // Around a ball the push turns with the place: -k n n' + push / r (1 - n n').
        let turn = if matches!(self.0, World::Ball(..)) && distance > 1e-3 {
            push / distance
        } else {
            0.0
        };
        for (row, (entries, along)) in contact.tangent.iter_mut().zip(normal).enumerate() {
            contact.wrench[row] = push * along;
            for (column, (entry, across)) in entries.iter_mut().zip(normal).enumerate() {
                let unit = f64::from(u8::from(row == column));
                *entry = -stiffness * along * across + turn * (unit - along * across);
            }
        }
        contact
    }
}

impl Solve for Analytic {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let contact = self.contact(state.body().position_m.map(f64::from));
        Solved {
            position_m: state.body().position_m,
            contact: Some(contact),
            status: Status::Ok,
            touched: contact.wrench != [0.0; 6],
            ..Solved::default()
        }
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        serde_json::Map::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Central differences with a step of 1 um: exact to 1e-6 of the stiffness.
    #[test]
    fn tangents_are_the_derivatives_of_the_forces() {
        for world in [World::Wall(500.0), World::Ball(500.0, 0.02)] {
            let analytic = Analytic(world);
            let place = [0.004, -0.006, -0.003];
            let at = analytic.contact(place);
            for column in 0..3 {
                let (mut up, mut down) = (place, place);
                up[column] += 1e-6;
                down[column] -= 1e-6;
                let (up, down) = (analytic.contact(up), analytic.contact(down));
                for row in 0..3 {
                    let slope = (up.wrench[row] - down.wrench[row]) / 2e-6;
                    let error = (slope - at.tangent[row][column]).abs();
                    assert!(error < 0.01, "{row} {column}: {error}");
                }
            }
        }
    }
}
