//! Where the labels of points go: near their points, beside each other, within the frame; far ones have a leader.
//!
//! Entry point: [`place`].

use crate::text::width;
use libm::{cos, sin};

/// A rectangle \[px\], y downwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
}

impl Region {
    fn overlaps(&self, other: &Region) -> bool {
        self.left < other.right
            && other.left < self.right
            && self.top < other.bottom
            && other.top < self.bottom
    }

    fn contains(&self, other: &Region) -> bool {
        self.left <= other.left
            && self.top <= other.top
            && self.right >= other.right
            && self.bottom >= other.bottom
    }

    fn around(x: f64, y: f64, half_width: f64, half_height: f64) -> Self {
        Region {
            left: x - half_width,
            top: y - half_height,
            right: x + half_width,
            bottom: y + half_height,
        }
    }
}

/// A point and what is to stand beside it.
pub struct Wanted {
    pub x: f64,
    pub y: f64,
    pub words: String,
}

/// Middle of a label.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    pub x: f64,
    pub y: f64,
    /// So far away that a line has to say whose it is.
    pub leader: bool,
}

/// Distances from the point \[px\], from the nearest; those from the third on have a leader.
const RINGS: [f64; 7] = [12.0, 18.0, 26.0, 36.0, 48.0, 62.0, 78.0];
const FIRST_WITH_LEADER: usize = 2;
/// Directions of a ring, from a little left of downwards: below a front that falls there is nothing.
const DIRECTIONS: u32 = 16;
const FIRST_DIRECTION: f64 = 112.5;
/// Half of a mark, with room around it \[px\].
const MARK: f64 = 6.0;

/// The best place of each label: over fewest of the marks, and near; none where all would lie over another label or leave
/// the frame.
pub fn place(
    wanted: &[Wanted],
    marks: &[(f64, f64)],
    frame: Region,
    size: f64,
) -> Vec<Option<Placed>> {
    let mut taken: Vec<Region> = Vec::new();
    let mut places = Vec::new();
    for label in wanted {
        let half_width = 0.5 * width(&label.words, size) + 2.0;
        let half_height = 0.5 * size + 1.0;
        let mut best: Option<(f64, Placed, Region)> = None;
        for (ring, distance) in RINGS.into_iter().enumerate() {
            for direction in 0..DIRECTIONS {
                let angle = (FIRST_DIRECTION
                    + 360.0 / f64::from(DIRECTIONS) * f64::from(turn(direction)))
                .to_radians();
                let placed = Placed {
                    x: label.x + (distance + half_width - half_height) * cos(angle),
                    y: label.y + distance * sin(angle),
                    leader: ring >= FIRST_WITH_LEADER,
                };
                let region = Region::around(placed.x, placed.y, half_width, half_height);
                if !frame.contains(&region) || taken.iter().any(|other| other.overlaps(&region)) {
                    continue;
                }
                let is_under = |mark: &&(f64, f64)| {
                    Region::around(mark.0, mark.1, MARK, MARK).overlaps(&region)
                };
                let cost = marks.iter().filter(is_under).count() as f64
                    + 0.15 * ring as f64
                    + 0.01 * f64::from(direction);
                if best.is_none_or(|(least, ..)| cost < least) {
                    best = Some((cost, placed, region));
                }
            }
        }
        taken.extend(best.map(|(.., region)| region));
        places.push(best.map(|(_, placed, _)| placed));
    }
    places
}

/// 0, 1, -1, 2, -2: to both sides of the first direction.
fn turn(direction: u32) -> i32 {
    let half = direction.div_ceil(2) as i32;
    if direction % 2 == 1 { half } else { -half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_one_place_stand_apart_or_are_missing() {
        let frame = Region {
            left: 0.0,
            top: 0.0,
            right: 300.0,
            bottom: 200.0,
        };
        let wanted: Vec<_> = (0..400)
            .map(|number| Wanted {
                x: 150.0,
                y: 100.0,
                words: number.to_string(),
            })
            .collect();
        let places = place(&wanted, &[(150.0, 100.0)], frame, 12.0);
        let regions: Vec<_> = wanted
            .iter()
            .zip(&places)
            .filter_map(|(label, place)| {
                place.map(|at| Region::around(at.x, at.y, 0.5 * width(&label.words, 12.0), 6.0))
            })
            .collect();
        assert!(regions.len() > 20 && regions.len() < 400);
        for (index, region) in regions.iter().enumerate() {
            assert!(frame.contains(region));
            assert!(regions[..index].iter().all(|other| !other.overlaps(region)));
        }
    }
}
