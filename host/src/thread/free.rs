//! How a model's threads lie in space where nothing draws them taut: for pictures and files.
//!
//! Entry points: [`FreeThreads::new`], [`FreeThreads::step`], [`FreeThreads::path`]. The thread of the balance has a length and a
//! tension, no shape where it is slack. Here every slack stretch between two points that hold it, or beyond the last one, is
//! a chain of its own as long as there is thread for it (Younes 2021, end of 3.3.2), held in the direction in which it comes
//! out of tissue or needle, and lying on the tissue. It takes nothing back to the balance, and only exists where somebody
//! asks for it.

use super::chain::{Chain, ChainReport, ChainSettings, Guide};
use super::model::{ThreadPlace, ThreadPoint};
use super::skin::Skin;
use super::stretch::{Begin, Stretch, stretches};
use crate::model::Model;
use crate::step::State;
use nalgebra::Vector3;

/// Nodes of a chain are about so far from each other \[m\]: a piece over a tube of 10 mm is 0.05 mm below its hull.
const SPACING_M: f64 = 2e-3;
/// Pieces of a chain; fewer do not bend, more take too long.
const PIECES: [usize; 2] = [8, 256];
/// A chain has other nodes once its pieces are longer or shorter than they are to be by this factor.
const RENEWED: f64 = 1.5;
/// Newton's steps of a chain in a step in time at most, which bounds what a picture takes: the next one goes on.
const MOST_NEWTON: usize = 12;
/// Guides of a chain at most: both ends, and what holds their directions.
const MOST_GUIDES: usize = 4;

/// A model's threads, with a shape.
#[derive(Clone, Debug)]
pub struct FreeThreads {
    gravity_m_per_s2: [f64; 3],
    skin: Skin,
    /// Where the tissue's nodes are \[m\], (n x 3).
    at: Vec<Vector3<f64>>,
    each: Vec<Free>,
}

#[derive(Clone, Debug)]
struct Free {
    id: u8,
    index: usize,
    radius_m: f64,
    slack: Vec<Slack>,
    path: Vec<ThreadPoint>,
}

/// A slack stretch.
#[derive(Clone, Debug)]
struct Slack {
    key: (u32, Begin),
    /// As many pieces as it has, and one more at each end that has a direction.
    chain: Chain,
    directed: [bool; 2],
}

impl FreeThreads {
    /// Of a model, all of them straight; `None` of one that has no thread.
    pub fn new(model: &Model, gravity_m_per_s2: [f64; 3]) -> Option<Self> {
        let parts = &model.sources.as_ref()?.threads.parts;
        let each = parts.iter().enumerate().map(|(index, part)| Free {
            id: part.id,
            index,
            radius_m: part.radius_m(),
            slack: Vec::new(),
            path: Vec::new(),
        });
        let each: Vec<_> = each.collect();
        if each.is_empty() {
            return None;
        }
        let at = places(model.points_m());
        Some(Self {
            gravity_m_per_s2,
            skin: Skin::new(&model.surface().triangles, &at),
            at,
            each,
        })
    }

    /// Forgets all shapes: in the next step everything begins straight and at rest.
    pub fn forget(&mut self) {
        for free in &mut self.each {
            free.slack.clear();
        }
    }

    /// Takes the shapes of another one of the same model.
    pub(super) fn lie_as(&mut self, other: &Self) {
        self.each.clone_from(&other.each);
    }

    /// Moves on by `dt_s`, above zero, to where threads and tissue are in `state`, whose nodes are at `nodes_m` (n x 3); the
    /// worst of what its chains report. Allocates.
    pub fn step(
        &mut self,
        dt_s: f64,
        model: &Model,
        state: &State,
        nodes_m: &[[f64; 3]],
    ) -> ChainReport {
        let mut worst = ChainReport::default();
        let Some((sources, threads)) = model.sources.as_ref().zip(state.sources.as_ref()) else {
            return worst;
        };
        self.at = places(nodes_m);
        self.skin.refit(&self.at);
        let tissue = (&self.skin, &self.at[..]);
        for free in &mut self.each {
            let places = threads.thread_places(sources, nodes_m, free.index);
            let (end_m, tangent) = threads.thread_ends(sources, free.index);
            let stretches = stretches(&places, end_m, &tangent);
            free.take(&stretches, self.gravity_m_per_s2, tissue);
            for (slack, stretch) in free.slack.iter_mut().zip(&stretches) {
                worst = worst.with(slack.step(dt_s, stretch, tissue));
            }
            free.path = drawn(&places, &stretches, &free.slack);
            // Where something else holds the head the path ends there, unless there is thread up to the needle.
            let reaches = stretches.iter().any(|each| each.next + 1 == places.len());
            if threads.is_head_in_hand(free.index) && !reaches {
                free.path.pop();
            }
        }
        worst
    }

    /// The path of a thread, from tail to head, as the last step left it; empty if there is none.
    pub fn path(&self, thread: u8) -> &[ThreadPoint] {
        let free = self.each.iter().find(|free| free.id == thread);
        free.map_or(&[], |free| &free.path)
    }
}

impl Free {
    /// A chain for each of these stretches: the one that it had, as long as it is now, or a new one.
    fn take(
        &mut self,
        stretches: &[Stretch],
        gravity_m_per_s2: [f64; 3],
        tissue: (&Skin, &[Vector3<f64>]),
    ) {
        let mut before = std::mem::take(&mut self.slack);
        for stretch in stretches {
            let place = before.iter().position(|slack| slack.key == stretch.key);
            let known = place.map(|place| before.swap_remove(place));
            let made = match known {
                Some(mut slack) => {
                    slack.fit(stretch);
                    Some(slack)
                }
                None => Slack::new(stretch, self.radius_m, gravity_m_per_s2, tissue),
            };
            // Numbers of which nothing can be made end what is drawn.
            let Some(slack) = made else {
                return;
            };
            self.slack.push(slack);
        }
    }
}

impl Slack {
    fn new(
        stretch: &Stretch,
        radius_m: f64,
        gravity_m_per_s2: [f64; 3],
        tissue: (&Skin, &[Vector3<f64>]),
    ) -> Option<Self> {
        let directed = stretch.directed();
        let pieces = pieces(stretch.length_m);
        let (nodes, total) = sizes(stretch.length_m, pieces, directed);
        let settings = ChainSettings {
            nodes,
            most_guides: MOST_GUIDES,
            gravity_m_per_s2,
            most_newton: MOST_NEWTON,
            ..ChainSettings::of_length(total).of_radius(radius_m)
        };
        let mut new = Self {
            key: stretch.key,
            chain: Chain::new(settings, &Vector3::zeros(), &Vector3::x())?,
            directed,
        };
        new.chain.bow_towards(stretch.out());
        let guides = new.guides(stretch);
        let down = Vector3::from(gravity_m_per_s2);
        new.chain.place(&guides, &stretch.clear_way(&down, tissue));
        Some(new)
    }

    /// Pieces of the stretch itself.
    fn pieces(&self) -> usize {
        let beyond = self.directed.map(usize::from);
        self.chain.nodes_m().len() - 1 - beyond[0] - beyond[1]
    }

    /// Of the stretch as long as it is now.
    fn fit(&mut self, stretch: &Stretch) {
        let directed = stretch.directed();
        let wanted = pieces(stretch.length_m);
        let own = self.pieces();
        let ratio = own as f64 / wanted as f64;
        let kept = (1.0 / RENEWED..=RENEWED).contains(&ratio);
        let pieces = if kept { own } else { wanted };
        let (nodes, total) = sizes(stretch.length_m, pieces, directed);
        self.chain.bow_towards(stretch.out());
        let before = self.directed.map(usize::from);
        if pieces == own && directed == self.directed {
            self.chain.lengthen(total);
            return;
        }
        // Counted in nodes of before, also those beyond the ends.
        let place = |node: usize| {
            let part = (node as f64 - f64::from(u8::from(directed[0]))) / pieces as f64;
            before[0] as f64 + part * own as f64
        };
        self.chain.renew(total, nodes, place);
        self.directed = directed;
    }

    /// Both ends, and a point before and behind that hold its direction.
    fn guides(&self, stretch: &Stretch) -> Vec<Guide> {
        let (last, segment) = (self.chain.nodes_m().len() - 1, self.chain.segment());
        let first = usize::from(self.directed[0]);
        let mut guides = Vec::with_capacity(MOST_GUIDES);
        let mut add = |node: usize, at: Vector3<f64>| {
            guides.push(Guide {
                along_m: self.chain.along_m(node),
                at_m: at.into(),
            });
        };
        let [from, to] = stretch.ends;
        if let Some(end) = from {
            if let Some(way) = end.way {
                add(0, end.at - way * segment);
            }
            add(first, end.at);
        }
        if let Some(end) = to {
            add(last - usize::from(self.directed[1]), end.at);
            if let Some(way) = end.way {
                add(last, end.at + way * segment);
            }
        }
        guides
    }

    fn step(
        &mut self,
        dt_s: f64,
        stretch: &Stretch,
        tissue: (&Skin, &[Vector3<f64>]),
    ) -> ChainReport {
        let guides = self.guides(stretch);
        self.chain.step(dt_s, &guides, Some(tissue))
    }

    /// Its nodes from end to end \[m\].
    fn nodes_m(&self) -> &[Vector3<f64>] {
        let nodes = self.chain.nodes_m();
        let [before, behind] = self.directed.map(usize::from);
        nodes.get(before..nodes.len() - behind).unwrap_or_default()
    }
}

/// A path with the nodes of its slack stretches, which are in its order.
fn drawn(
    places: &[(u32, ThreadPoint)],
    stretches: &[Stretch],
    slack: &[Slack],
) -> Vec<ThreadPoint> {
    let mut path = Vec::with_capacity(places.len());
    let mut next = 0;
    let mut chains = stretches.iter().zip(slack);
    let mut upto = |path: &mut Vec<ThreadPoint>, place: usize| {
        let own = places.get(next..place).unwrap_or_default();
        path.extend(own.iter().map(|(_, point)| *point));
        next = next.max(place);
    };
    for (stretch, slack) in &mut chains {
        upto(&mut path, stretch.first);
        let nodes = slack.nodes_m();
        let piece_m = stretch.length_m / (nodes.len() - 1) as f64;
        let [from, to] = stretch.ends.map(|end| usize::from(end.is_some()));
        for (node, at) in nodes.iter().enumerate() {
            if node < from || node + to >= nodes.len() {
                continue;
            }
            path.push(ThreadPoint {
                at_m: (*at).into(),
                along_m: stretch.along_m + piece_m * node as f64,
                what: if node == 0 {
                    ThreadPlace::End
                } else {
                    ThreadPlace::Hangs
                },
                tension_n: 0.0,
            });
        }
        // What it bent around while it was taut is none of it.
        upto(&mut Vec::new(), stretch.next);
    }
    upto(&mut path, places.len());
    // A loose end is where its chain ends.
    for place in 0..path.len() {
        if path[place].what == ThreadPlace::Cut {
            let is_end = |next: &&ThreadPoint| next.what != ThreadPlace::Cut;
            let beside = [place.checked_sub(1), Some(place + 1)];
            let mut beside = beside
                .into_iter()
                .flatten()
                .filter_map(|place| path.get(place));
            if let Some(at_m) = beside.find(is_end).map(|end| end.at_m) {
                path[place].at_m = at_m;
            }
        }
    }
    path
}

/// How many pieces a stretch of this length is made of.
fn pieces(length_m: f64) -> usize {
    let [least, most] = PIECES;
    ((length_m / SPACING_M).ceil() as usize).clamp(least, most)
}

/// Nodes and length of a chain with so many pieces between its ends \[m\].
fn sizes(length_m: f64, pieces: usize, directed: [bool; 2]) -> (usize, f64) {
    let all = pieces + directed.iter().filter(|is| **is).count();
    (all + 1, length_m / pieces as f64 * all as f64)
}

fn places(positions: &[[f64; 3]]) -> Vec<Vector3<f64>> {
    positions.iter().map(|at| Vector3::from(*at)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::stretch::Held;
    use super::*;
    use crate::mesh::tube;
    use nalgebra::Rotation3;

    /// A loop on a tube's outside, what hangs from it, loose, and what a needle holds above the rim, so that it lies on the other side's.
    fn stretches_on_a_tube(turned: &Rotation3<f64>) -> [Stretch; 3] {
        let at = |angle: f64, z: f64| {
            let (sin, cos) = angle.sin_cos();
            Vector3::new(0.011 * cos, 0.011 * sin, z)
        };
        let held = |at: Vector3<f64>, sign: f64| Held {
            at: turned * at,
            way: Some(turned * Vector3::new(at.x, at.y, 0.0).normalize() * sign),
        };
        let both = Stretch {
            key: (3, Begin::Face),
            ends: [
                Some(held(at(0.1, 0.013), 1.0)),
                Some(held(at(0.7, 0.011), -1.0)),
            ],
            length_m: 0.012,
            along_m: -0.2,
            first: 1,
            next: 1,
        };
        let loose = Stretch {
            key: (0, Begin::Loose),
            ends: [None, Some(held(at(0.1, 0.013), -1.0))],
            length_m: 0.1,
            ..both
        };
        let above = Held {
            at: turned * Vector3::new(0.009, 0.0, 0.031),
            way: Some(turned * Vector3::new(1.0, 0.1, 0.05).normalize()),
        };
        let over = Stretch {
            ends: [None, Some(above)],
            ..loose
        };
        [both, loose, over]
    }

    /// After two seconds, in a scene that is turned as a whole.
    fn settled(turned: &Rotation3<f64>, gravity: Vector3<f64>, dt_s: f64) -> Vec<Vector3<f64>> {
        let mesh = tube([0.008, 0.011], [0.0, 0.03], [2, 24, 8]).expect("a tube");
        let points = mesh.points_m().iter();
        let at: Vec<_> = points.map(|p| turned * Vector3::from(*p)).collect();
        let skin = Skin::new(&mesh.surface().triangles, &at);
        let gravity = (turned * gravity).into();
        let (mut all, mut touching) = (Vec::new(), 0);
        for stretch in stretches_on_a_tube(turned) {
            let mut slack = Slack::new(&stretch, 1.25e-4, gravity, (&skin, &at)).expect("a chain");
            for _ in 0..(2.0 / dt_s) as u32 {
                let report = slack.step(dt_s, &stretch, (&skin, &at));
                assert!(report.length_error < 1e-9, "{report:?}");
                touching += report.touching;
            }
            let nodes = slack.nodes_m();
            let pieces = nodes.windows(2).map(|two| two[0].metric_distance(&two[1]));
            let length: f64 = pieces.sum();
            assert!((length / stretch.length_m - 1.0).abs() < 1e-9, "{length} m");
            for (end, node) in stretch.ends.iter().zip([0, nodes.len() - 1]) {
                assert!(end.is_none_or(|end| end.at == nodes[node]));
            }
            for node in nodes {
                let depth = skin.distance(&at, node, 0.0);
                assert!(depth.is_none_or(|(far, _)| far > -1e-9), "{node:?}");
            }
            all.extend(nodes.iter().map(|at| turned.inverse() * at));
        }
        assert!(touching > 0);
        all
    }

    /// Without gravity, or where that is turned with it, a turned scene has the turned shape; with gravity that stays another one.
    #[test]
    fn a_turned_scene_has_the_turned_shape() {
        let turned = Rotation3::from_euler_angles(0.4, -1.1, 2.0);
        for gravity in [Vector3::zeros(), Vector3::new(0.0, 0.0, -9.81)] {
            let [one, other] = [Rotation3::identity(), turned].map(|by| settled(&by, gravity, 0.1));
            let apart = one.iter().zip(&other).map(|(a, b)| a.metric_distance(b));
            let apart = apart.fold(0.0, f64::max);
            assert!(apart < 1e-6, "{apart} m with {gravity:?}");
        }
        let down = Vector3::new(0.0, 0.0, -9.81);
        let stays = settled(&turned, turned.inverse() * down, 0.1);
        let far = settled(&turned, down, 0.1)
            .iter()
            .zip(&stays)
            .map(|(a, b)| a.metric_distance(b))
            .fold(0.0, f64::max);
        assert!(far > 0.01, "{far} m");
    }

    /// A stretch that is drawn in keeps what it has of a shape, and has fewer nodes in the end.
    #[test]
    fn a_stretch_that_is_drawn_in_keeps_its_length() {
        let still = Rotation3::identity();
        let mesh = tube([0.008, 0.011], [0.0, 0.03], [2, 24, 8]).expect("a tube");
        let points = mesh.points_m().iter();
        let at: Vec<_> = points.map(|p| Vector3::from(*p)).collect();
        let skin = Skin::new(&mesh.surface().triangles, &at);
        let [_, mut loose, _] = stretches_on_a_tube(&still);
        let down = [0.0, 0.0, -9.81];
        let mut slack = Slack::new(&loose, 1.25e-4, down, (&skin, &at)).expect("a chain");
        let first = slack.nodes_m().len();
        let mut before = loose.length_m;
        while loose.length_m > 0.02 {
            slack.fit(&loose);
            let report = slack.step(0.1, &loose, (&skin, &at));
            assert!(report.length_error < 1e-9, "{report:?}");
            let nodes = slack.nodes_m();
            let pieces = nodes.windows(2).map(|two| two[0].metric_distance(&two[1]));
            let length: f64 = pieces.sum();
            assert!((length / loose.length_m - 1.0).abs() < 1e-9, "{length} m");
            assert!(length < before + 1e-12);
            before = length;
            loose.length_m -= 3e-3;
        }
        assert!(slack.nodes_m().len() < first / 2);
    }
}
