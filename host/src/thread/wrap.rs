//! Where a taut thread bends over tissue that a straight piece of it would cut.
//!
//! Entry point: [`wraps`]. Younes 2021 has straight pieces between punctures (3.32); these go through tissue that
//! bulges between them. A taut string is as short as the tissue lets it be: within the plane that
//! contains the chord and the way out of the tissue it is the upper hull of the tissue's section. The
//! section is followed from where the chord goes into the tissue, face by face, to where it comes out: what
//! hangs over the chord without being cut by it, a tube's other wall, has no part in it. Within that plane
//! only: on a saddle the shortest string leaves it, and would be shorter.

use super::skin::{Side, Skin};
use nalgebra::Vector3;

/// A point on an edge of the boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wrap {
    /// The edge's ends, lower node first.
    pub nodes: [u32; 2],
    /// Their parts in it, each at least 0; they add up to 1.
    pub weights: [f64; 2],
}

/// Of the chord's length: tissue that is cut less deeply than this is not cut. Punctures lie in the surface, so that
/// rounding says on which side of it a chord begins; one that is lifted by this begins outside.
const LIFT: f64 = 1e-7;
/// Points that a hull has room for; the flattest go first. A chord meets about ten edges.
const MOST_POINTS: usize = 64;
/// Faces in a row that the section is followed through, so that it ends on any mesh.
const MOST_FACES: usize = 1024;
/// Part of the least turn down to which a string stays bent over an edge that it bent over before: it presses that down, so that it would
/// turn less, come off, and bend again, with hands that stay where they are.
const KEPT: f64 = 0.2;
/// Of its length, what is left of the way out of the tissue across the chord, or there is no plane.
const LEAST_ACROSS: f64 = 1e-9;

/// Appends where a taut string from `from` to `to` \[m\], both on the surface or above it, bends over the
/// tissue whose nodes are at `at` \[m\], in the plane that contains the chord and `up`, the mean of outward
/// normals: from first to last, as many as `out` has room for. Bends of less than `least_turn` \[rad\] are left out,
/// the least first; over the edges `former`, lower node first, (k x 2), those of less than a fifth of that. Nothing if the chord is
/// free, if there is no plane, or if something is no number. Allocates nothing.
pub(crate) fn wraps(
    skin: &Skin,
    at: &[Vector3<f64>],
    from: &Vector3<f64>,
    to: &Vector3<f64>,
    up: &Vector3<f64>,
    (least_turn, former): (f64, &[[u32; 2]]),
    out: &mut Vec<Wrap>,
) {
    let Some(plane) = Plane::new(from, to, up) else {
        return;
    };
    let mut hull = Hull::new(plane.length);
    let lift = plane.up * (LIFT * plane.length);
    skin.along(&(from + lift), &(to + lift), |face| {
        plane.follow(skin, at, face, &mut hull);
    });
    hull.reduce(least_turn, former, out.capacity() - out.len());
    out.extend(hull.points[..hull.count].iter().map(|point| point.wrap));
}

/// The plane of a chord, with the chord's start for its origin.
struct Plane {
    origin: Vector3<f64>,
    /// Unit vectors along the chord, out of the tissue, and across the plane: right-handed.
    along: Vector3<f64>,
    up: Vector3<f64>,
    across: Vector3<f64>,
    length: f64,
}

/// A corner of a face, seen from the plane.
#[derive(Clone, Copy)]
struct Corner {
    node: u32,
    at: Vector3<f64>,
    /// How far across the plane \[m\]. A corner in the plane counts as beyond it, everywhere.
    beyond: f64,
}

impl Plane {
    fn new(from: &Vector3<f64>, to: &Vector3<f64>, up: &Vector3<f64>) -> Option<Self> {
        let chord = to - from;
        let length = chord.norm();
        let along = chord / length;
        let up = up.try_normalize(0.0)?;
        let rest = up - along * along.dot(&up);
        let left = rest.norm();
        let sound = length > 0.0 && length.is_finite() && left > LEAST_ACROSS;
        sound.then(|| {
            let up = rest / left;
            Self {
                origin: *from,
                along,
                up,
                across: along.cross(&up),
                length,
            }
        })
    }

    fn corner(&self, at: &[Vector3<f64>], node: u32) -> Option<Corner> {
        let at = *at.get(node as usize)?;
        let beyond = self.across.dot(&(at - self.origin));
        beyond.is_finite().then_some(Corner { node, at, beyond })
    }

    /// Where an edge between two sides of the plane crosses it; the same bits for either direction.
    fn crossing(&self, a: &Corner, b: &Corner) -> Point {
        let (a, b) = if a.node < b.node { (a, b) } else { (b, a) };
        let share = a.beyond / (a.beyond - b.beyond);
        let at = a.at * (1.0 - share) + b.at * share - self.origin;
        Point {
            s: self.along.dot(&at),
            h: self.up.dot(&at),
            wrap: Wrap {
                nodes: [a.node, b.node],
                weights: [1.0 - share, share],
            },
        }
    }

    /// If the chord goes into the tissue through `face`, follows the section from there for as long as it is
    /// above the chord, and takes its points into the hull. Seen with `up` upwards and the chord running to
    /// the right a section runs with the tissue to its right, so that it rises where the chord goes in.
    fn follow(&self, skin: &Skin, at: &[Vector3<f64>], face: u32, hull: &mut Hull) {
        let nodes = skin.face(face);
        let Some(corners) = self.corners(at, nodes) else {
            return;
        };
        // A face's section runs from where its rim comes from this side of the plane to where it goes back.
        let side_of = |corner: usize| corners[corner].beyond >= 0.0;
        let comes = (0..3).find(|&k| !side_of(k) && side_of((k + 1) % 3));
        let goes = (0..3).find(|&k| side_of(k) && !side_of((k + 1) % 3));
        let (Some(comes), Some(goes)) = (comes, goes) else {
            return;
        };
        let tail = self.crossing(&corners[comes], &corners[(comes + 1) % 3]);
        let mut head = self.crossing(&corners[goes], &corners[(goes + 1) % 3]);
        let least = LIFT * self.length;
        if !(tail.h <= least && head.h > least) {
            return;
        }
        let share = (least - tail.h) / (head.h - tail.h);
        let enters = tail.s + share * (head.s - tail.s);
        if !(0.0..=self.length).contains(&enters) {
            return;
        }
        let mut side = Side {
            face,
            corner: goes as u32,
        };
        for _ in 0..MOST_FACES {
            if !(head.h > least && 0.0 < head.s && head.s < self.length) {
                return;
            }
            hull.take(head);
            let Some(beyond) = skin.across(side) else {
                return;
            };
            let corner = beyond.corner as usize;
            let Some(corners) = self.corners(at, skin.face(beyond.face)) else {
                return;
            };
            let (low, high) = (corner, (corner + 1) % 3);
            let last = (corner + 2) % 3;
            let goes = if corners[last].beyond >= 0.0 {
                [last, low]
            } else {
                [high, last]
            };
            head = self.crossing(&corners[goes[0]], &corners[goes[1]]);
            side = Side {
                face: beyond.face,
                corner: goes[0] as u32,
            };
        }
    }

    fn corners(&self, at: &[Vector3<f64>], nodes: [u32; 3]) -> Option<[Corner; 3]> {
        let [a, b, c] = nodes.map(|node| self.corner(at, node));
        Some([a?, b?, c?])
    }
}

/// A point of a section, along the chord and above it \[m\].
#[derive(Clone, Copy)]
struct Point {
    s: f64,
    h: f64,
    wrap: Wrap,
}

impl Point {
    const fn end(s: f64) -> Self {
        Self {
            s,
            h: 0.0,
            wrap: Wrap {
                nodes: [0; 2],
                weights: [0.0; 2],
            },
        }
    }

    /// tan of half the angle by which a string turns down at `self` on its way from `a` to `b`; grows with
    /// it up to half a turn.
    fn turn(&self, a: &Self, b: &Self) -> f64 {
        let (x, y) = (self.s - a.s, self.h - a.h);
        let (u, v) = (b.s - self.s, b.h - self.h);
        (y * u - x * v) / ((x * x + y * y).sqrt() * (u * u + v * v).sqrt() + x * u + y * v)
    }

    /// Whether it lies above the line from `a` to `b`.
    fn above(&self, a: &Self, b: &Self) -> bool {
        (self.h - a.h) * (b.s - self.s) > (b.h - self.h) * (self.s - a.s)
    }
}

/// The upper hull of a chord's ends and the points taken so far.
struct Hull {
    length: f64,
    /// Between the ends, ascending along the chord.
    points: [Point; MOST_POINTS],
    count: usize,
}

impl Hull {
    fn new(length: f64) -> Self {
        Self {
            length,
            points: [Point::end(0.0); MOST_POINTS],
            count: 0,
        }
    }

    /// By place, the ends beyond the first and the last.
    fn before(&self, place: usize) -> Point {
        place
            .checked_sub(1)
            .map_or(Point::end(0.0), |place| self.points[place])
    }

    fn from(&self, place: usize) -> Point {
        if place < self.count {
            self.points[place]
        } else {
            Point::end(self.length)
        }
    }

    fn remove(&mut self, place: usize) {
        self.points.copy_within(place + 1..self.count, place);
        self.count -= 1;
    }

    /// Of a point strictly between the ends.
    fn take(&mut self, point: Point) {
        if self.count == MOST_POINTS
            && let Some((place, _)) = self.flattest(|_| 1.0)
        {
            self.remove(place);
        }
        let mut place = self.points[..self.count].partition_point(|other| other.s < point.s);
        if place < self.count && self.points[place].s == point.s {
            if point.h <= self.points[place].h {
                return;
            }
            self.remove(place);
        }
        if !point.above(&self.before(place), &self.from(place)) {
            return;
        }
        self.points.copy_within(place..self.count, place + 1);
        self.points[place] = point;
        self.count += 1;
        while place > 0 && !self.points[place - 1].above(&self.before(place - 1), &point) {
            place -= 1;
            self.remove(place);
        }
        while place + 1 < self.count && !self.points[place + 1].above(&point, &self.from(place + 2))
        {
            self.remove(place + 1);
        }
    }

    /// The point of the least turn, each over what `part` says of it, and tan of half of that.
    fn flattest(&self, part: impl Fn(&Point) -> f64) -> Option<(usize, f64)> {
        let turns = (0..self.count).map(|place| {
            let (before, after) = (self.before(place), self.from(place + 1));
            let point = &self.points[place];
            (place, point.turn(&before, &after) / part(point))
        });
        turns.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Leaves no bend of less than `least_turn` \[rad\], over `former` edges of less than [`KEPT`] of that, and no more than `room`
    /// of them.
    fn reduce(&mut self, least_turn: f64, former: &[[u32; 2]], room: usize) {
        let least = (0.5 * least_turn).tan();
        let part = |point: &Point| {
            if former.contains(&point.wrap.nodes) {
                KEPT
            } else {
                1.0
            }
        };
        while let Some((place, turn)) = self.flattest(part) {
            if self.count <= room && turn >= least {
                break;
            }
            self.remove(place);
        }
    }
}

#[cfg(test)]
mod tests;
