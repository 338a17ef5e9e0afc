//! How the wrench of the needles that a tool holds follows the tool, slides included.
//!
//! Entry points: [`TangentWork::factor`], then [`TangentWork::differentiate`] for each tool. With f the
//! force on the tissue at a point of a needle, x where that is, s the needle's point and (t, n, b) its
//! frame there: what sticks has `ds = dx`. What slides has `ds + t dalpha = dx` and keeps `f.t`, which
//! turns with the pose and, on an arc of curvature kappa, with alpha. Unknown is `df = -(t n b) dLambda`,
//! and `dx = W df`; dalpha is eliminated. The normals of tools that do not rub turn within W (see
//! [`crate::source::tool::Turning`]); where nothing else slides the matrix is symmetric, and a Cholesky factor does.

use super::balance::{Balance, BalanceWork};
use crate::jaws::Gripped;
use crate::needle::{Curve, Point, Tip, What, friction_of};
use crate::rows::{Mode, RowKind};
use crate::source::tool::{Contact, Load, Touched, Turns};
use crate::thread::{EndRows, Tie};
use crate::tool::ToolSample;
use nalgebra::{Matrix6, Vector3, Vector6};
use sutura_factor::{Dense, Lu};

/// Scratch for so many rows.
pub(crate) struct TangentWork {
    lu: Lu,
    dense: Dense,
    matrix: Vec<f64>,
    /// Right-hand sides, then dLambda, (n x 6).
    change: Vec<f64>,
    /// What tools that rub touch, and needles lie on.
    touched: Vec<(Owner, Touched)>,
    /// All contacts, and whether some of those that do not rub turn.
    contacts: Vec<Contact>,
    turns: bool,
    load: Load,
    /// J, (n x 6).
    jacobian: Vec<f64>,
    /// Ways of the rows by forces of threads that turn with a body, (n x 6).
    swung: Vec<f64>,
    /// Rows without force.
    free: Vec<bool>,
    /// Rows of needles whose multiplier follows the way along them, and by how much \[N/m\].
    follow: Vec<(usize, f64)>,
    /// Of rows of threads at a bound, which answer what others do, not a motion.
    ties: Vec<Tie>,
    factor: Factor,
    /// Rows that bear loads, and what they answer, (n x 6).
    loaded: Vec<usize>,
    answers: Vec<f64>,
    /// For answers of the last solve, (n x 12).
    scratch: Vec<f64>,
}

/// What solves for changes of the rows' multipliers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Factor {
    /// That of the last solve.
    Solved,
    Cholesky,
    Lu,
}

/// Whose a contact is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Owner {
    /// By its place among the tools that touch.
    Tool(u32),
    Needle(usize),
    Bar(usize),
}

/// What moves with a tool's grip.
pub(crate) struct Moves<'a> {
    pub needle: &'a dyn Fn(usize) -> bool,
    /// Place among the tools that touch.
    pub tool: Option<u32>,
    /// Place among the jaws.
    pub jaws: Option<usize>,
    /// Place among the bars.
    pub bar: Option<usize>,
}

impl Moves<'_> {
    /// Points of the jaws that move.
    fn gripped<'b>(&self, work: &'b BalanceWork) -> impl Iterator<Item = &'b Gripped> {
        let jaws = self.jaws;
        let points = work.jaws.points.iter();
        points.filter(move |point| Some(point.jaws) == jaws)
    }

    /// Points of the needles that move.
    fn points(&self, balance: &Balance) -> impl Iterator<Item = Held> {
        let points = balance.work.needles.points.iter().enumerate();
        let own = points.filter(|(_, point)| (self.needle)(point.needle));
        let own = own.filter(|(_, point)| friction_of(balance.work, point).is_none());
        own.map(|(index, point)| {
            let at = balance.position_of(&balance.work.set.anchors[index]);
            held(balance, index, point, at)
        })
    }

    /// Whether it moves with the grip.
    fn has(&self, owner: Owner) -> bool {
        match owner {
            Owner::Tool(tool) => self.tool == Some(tool),
            Owner::Needle(needle) => (self.needle)(needle),
            Owner::Bar(bar) => self.bar == Some(bar),
        }
    }
}

/// An end of a thread that a tool holds, or the needle that it holds; or a straight piece at a body of its that the thread lies on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pull {
    /// From the grip to the end, or to the other end of the piece \[m\].
    pub arm: Vector3<f64>,
    /// On the end, or the body \[N\].
    pub force: Vector3<f64>,
    pub rows: EndRows,
    /// Of a piece at a body: the way with which its other end moves, if that is of tissue, and 1 or -1 for with or against it.
    pub on_body: Option<Option<(usize, f64)>>,
}

/// One point of a needle and its force.
struct Held {
    row: usize,
    frame: [Vector3<f64>; 3],
    /// s(alpha).
    on_needle: Vector3<f64>,
    /// x.
    in_tissue: Vector3<f64>,
    force: Vector3<f64>,
    curvature: f64,
    law: Law,
}

#[derive(Clone, Copy, PartialEq)]
enum Law {
    Sticks,
    Slides,
    /// The end of a cut, which only holds along the needle.
    Cut {
        sticks: bool,
    },
}

impl TangentWork {
    pub fn new(most_rows: usize, most_contacts: usize) -> Self {
        Self {
            lu: Lu::new(most_rows),
            dense: Dense::new(most_rows),
            matrix: vec![0.0; most_rows * most_rows],
            change: vec![0.0; 6 * most_rows],
            touched: Vec::with_capacity(most_contacts + most_rows / 3),
            contacts: Vec::with_capacity(most_contacts),
            turns: false,
            load: Load::new(if most_contacts > 0 { most_rows } else { 0 }, most_contacts),
            jacobian: vec![0.0; 6 * most_rows],
            swung: vec![0.0; 6 * most_rows],
            free: Vec::with_capacity(most_rows),
            follow: Vec::with_capacity(most_rows),
            ties: Vec::with_capacity(2 * most_rows),
            factor: Factor::Lu,
            loaded: Vec::with_capacity(6),
            answers: vec![0.0; 6 * most_rows],
            scratch: vec![0.0; 12 * most_rows],
        }
    }

    fn factor_rows(&mut self, balance: &mut Balance) {
        let n = balance.work.count();
        let tools = &balance.state.tools;
        self.touched.clear();
        self.contacts.clear();
        self.contacts.extend_from_slice(&tools.contacts);
        let touched = tools.contacts.iter().filter_map(|contact| {
            let touched = Touched::new(&balance.sources.tools, tools, contact)?;
            Some((Owner::Tool(contact.tool), touched))
        });
        self.touched.extend(touched);
        self.touched.extend(lying(balance));
        self.touched.extend(leaning(balance));
        if n == 0 {
            return;
        }
        self.turns = balance.turn_normals(Turns::Smooth);
        balance.tie_threads(&mut self.ties);
        let (balance, work) = (&*balance, &*balance.work);
        self.find_laws(balance);
        let slides = self.touched.iter().any(|(_, touched)| touched.slides())
            || work.jaws.points.iter().any(|point| point.slips);
        let follows = !self.follow.is_empty() || self.ties.iter().any(|tie| tie.less != 0.0);
        let symmetric = !slides && !follows;
        let replaced = !self.touched.is_empty() || !work.jaws.points.is_empty();
        let as_solved = symmetric && !replaced && !self.turns && self.ties.is_empty();
        if as_solved && work.system.solved_rows().answers(&self.free, SAME) {
            self.factor = Factor::Solved;
            return;
        }
        if symmetric {
            self.gather(work, 0.0);
            let matrix = &mut self.matrix[..n * n];
            if self.dense.factor(matrix, n).is_ok() && is_regular(matrix, n) {
                self.factor = Factor::Cholesky;
                return;
            }
        }
        self.factor = Factor::Lu;
        self.gather(work, REGULAR);
        self.lu.factor(&mut self.matrix[..n * n], n);
    }

    /// Which rows bear no force, and which follow what they hold.
    fn find_laws(&mut self, balance: &Balance) {
        let (work, grasp) = (&*balance.work, &balance.state.grasp);
        let n = work.count();
        let w = compliance(self.turns, work);
        // Rows of threads and of tissues that touch act or do not, or are tied to others that act.
        let of_points = 3 * work.needles.points.len();
        let (lambda, modes) = (grasp.lambda(), grasp.modes());
        let free = (0..n).map(|row| {
            let open = match work.set.rows.get(row).map(|row| row.kind) {
                // What is open has been let go of.
                Some(RowKind::Tangent) if work.tools.rows.contains(&row) => false,
                Some(_) if work.tools.rows.contains(&row) => lambda[row] <= 0.0,
                // As of needles.
                Some(_) if work.bars.rows.contains(&row) => false,
                Some(_) if work.jaws.rows.contains(&row) => {
                    !matches!(modes[row], Mode::Held | Mode::Slipping)
                }
                _ => row >= of_points && modes[row] != Mode::Held,
            };
            open || w[row * (n + 1)] == 0.0
        });
        self.free.clear();
        self.free.extend(free);
        self.ties.iter().for_each(|tie| self.free[tie.row] = true);
        for tie in self.ties.iter().filter(|tie| tie.less != 0.0) {
            self.free[tie.row] = w[tie.row * (n + 1)] == 0.0;
        }
        for row in work.tools.rows.clone() {
            let tangent = |row: usize| work.set.rows.get(row).map(|row| row.kind);
            if row > 0 && tangent(row) == Some(RowKind::Tangent) {
                self.free[row] |= self.free[row - 1];
            }
        }
        for point in &work.bars.points {
            if lambda[point.first_row] <= 0.0 {
                self.free[point.first_row..point.first_row + 3].fill(true);
            }
        }
        self.follow.clear();
        for (index, point) in work.needles.points.iter().enumerate() {
            if friction_of(work, point).is_some() {
                let rows = point.first_row..point.first_row + 3;
                if lambda[point.first_row] <= 0.0 {
                    self.free[rows].fill(true);
                }
                continue;
            }
            let held = held(balance, index, point, Vector3::zeros());
            match held.law {
                Law::Sticks => {}
                Law::Slides => {
                    let inward = -held.force.dot(&held.frame[1]);
                    self.follow.push((held.row, held.curvature * inward));
                }
                Law::Cut { sticks } => {
                    let rows = held.row + usize::from(sticks)..held.row + 3;
                    self.follow.extend(rows.map(|row| (row, 0.0)));
                }
            }
        }
    }

    /// The matrix, with rows' own compliance raised by a part that makes it `regular`.
    fn gather(&mut self, work: &BalanceWork, regular: f64) {
        let n = work.count();
        let w = compliance(self.turns, work);
        let matrix = &mut self.matrix[..n * n];
        matrix.copy_from_slice(w);
        for (row, scale) in &self.follow {
            for column in 0..n {
                let entry = scale * w[n * column + row];
                matrix[n * column + row] = f64::from(u8::from(column == *row)) - entry;
            }
        }
        for (_, touched) in &self.touched {
            touched.replace(matrix, w, n);
        }
        for gripped in &work.jaws.points {
            gripped.replace(matrix, w, n);
        }
        for Tie { row, .. } in &self.ties {
            (0..n).for_each(|column| matrix[n * column + row] = 0.0);
            matrix[row * (n + 1)] = 1.0;
        }
        for tie in &self.ties {
            let columns = tie.to.clone();
            columns.for_each(|column| matrix[n * column + tie.row] = tie.less);
        }
        for (row, is_free) in self.free.iter().enumerate() {
            if *is_free {
                free(matrix, n, row);
            } else {
                matrix[row * (n + 1)] *= 1.0 + regular;
            }
        }
    }

    /// J of all rows for a motion of a tool that does not rub, right-hand sides for it, and what its wrench does without the
    /// rows' answer; none if it touches nothing.
    fn load_smooth(
        &mut self,
        work: &BalanceWork,
        tool: Option<u32>,
        grip: &Vector3<f64>,
    ) -> Option<Matrix6<f64>> {
        let n = work.count();
        let (tool, turning) = (tool?, work.tools.known_turning()?);
        if !turning.slides(&self.contacts, tool) {
            return None;
        }
        let of = (&self.contacts[..], tool);
        let jacobian = &mut self.jacobian[..6 * n];
        jacobian.fill(0.0);
        turning.lead(of, grip, jacobian);
        let all = |_| true;
        let system = (&work.system, &work.set);
        let answer = self.load.add(turning, of, grip, all, system, jacobian);
        let changes = self.change[..6 * n].chunks_exact_mut(n);
        for (change, moved) in changes.zip(jacobian.chunks_exact(n)) {
            for (change, moved) in change.iter_mut().zip(moved) {
                *change = -moved;
            }
            for (row, scale) in &self.follow {
                change[*row] *= -scale;
            }
            for (_, touched) in &self.touched {
                touched.follow(change);
            }
            for gripped in &work.jaws.points {
                gripped.follow(change);
            }
            for (change, _) in change.iter_mut().zip(&self.free).filter(|(_, free)| **free) {
                *change = 0.0;
            }
        }
        Some(answer + turning.turned(of, grip))
    }

    /// d wrench / d pose of what `moves`, for left increments about `grip`, (6 x 6).
    pub fn differentiate(
        &mut self,
        balance: &Balance,
        grip: &Vector3<f64>,
        moves: Moves,
        pulls: &[Pull],
    ) -> Matrix6<f64> {
        let work = &*balance.work;
        let n = work.count();
        let has = |of: &(Owner, Touched)| moves.has(of.0);
        if n == 0 {
            return Matrix6::zeros();
        }
        self.change[..6 * n].fill(0.0);
        let smooth = self.load_smooth(work, moves.tool, grip);
        let nothing = !work
            .needles
            .points
            .iter()
            .any(|point| (moves.needle)(point.needle))
            && smooth.is_none()
            && moves.gripped(work).next().is_none()
            && !self.touched.iter().any(has);
        if nothing && pulls.is_empty() {
            return Matrix6::zeros();
        }
        self.load_needles(balance, grip, &moves);
        self.load_threads(balance, pulls);
        self.load_rough(balance, grip, &moves);
        self.load_jaws(balance, grip, &moves);
        self.load_turned(work, pulls);
        for change in self.change[..6 * n].chunks_exact_mut(n) {
            self.ties.iter().for_each(|tie| change[tie.row] = 0.0);
        }
        self.answer(work);
        let mut tangent = smooth.map_or_else(Matrix6::zeros, |smooth| {
            let [moved, forces] = [&self.jacobian, &self.change];
            smooth
                + Matrix6::from_fn(|i, j| {
                    product(&moved[n * i..n * (i + 1)], &forces[n * j..n * (j + 1)])
                })
        });
        self.add_points(balance, grip, &moves, &mut tangent);
        self.add_threads(work, pulls, &mut tangent);
        tangent
    }

    /// Takes loads of the rows by the six motions for what the rows answer. Where few rows bear any, as where a hand pulls a
    /// thread, each of these answers a load of one, and the answers are added up.
    fn answer(&mut self, work: &BalanceWork) {
        let n = work.count();
        let Self {
            change,
            answers,
            loaded,
            ..
        } = self;
        let change = &mut change[..6 * n];
        loaded.clear();
        let bears = |row: &usize| change.iter().skip(*row).step_by(n).any(|load| *load != 0.0);
        loaded.extend((0..n).filter(bears).take(6));
        let few = loaded.len();
        if few == 0 {
            return;
        }
        if few == 6 {
            answers[..6 * n].copy_from_slice(change);
            self.solve(work, 6);
            self.change[..6 * n].copy_from_slice(&self.answers[..6 * n]);
            return;
        }
        let loads = Matrix6::from_fn(|at, pose| match loaded.get(at) {
            Some(row) => change[n * pose + row],
            None => 0.0,
        });
        answers[..few * n].fill(0.0);
        for (column, row) in loaded.iter().enumerate() {
            answers[n * column + row] = 1.0;
        }
        self.solve(work, few);
        self.change[..6 * n].fill(0.0);
        for (change, loads) in self.change.chunks_exact_mut(n).zip(loads.column_iter()) {
            let answers = self.answers[..few * n].chunks_exact(n);
            for (answer, load) in answers.zip(&loads).filter(|(_, load)| **load != 0.0) {
                for (change, answer) in change.iter_mut().zip(answer) {
                    *change += load * answer;
                }
            }
        }
    }

    /// Takes the first `columns` of loads in `answers` for the rows' answers.
    fn solve(&mut self, work: &BalanceWork, columns: usize) {
        let n = work.count();
        let (matrix, answers) = (&self.matrix[..n * n], &mut self.answers[..columns * n]);
        match self.factor {
            Factor::Solved => {
                let (dense, scratch) = (&mut self.dense, &mut self.scratch);
                work.system.solved_rows().answer(answers, dense, scratch);
            }
            Factor::Cholesky => self.dense.solve(matrix, n, answers, columns),
            Factor::Lu => self.lu.solve(matrix, n, answers, columns),
        }
    }

    /// Right-hand sides of what needles that move do to their rows.
    fn load_needles(&mut self, balance: &Balance, grip: &Vector3<f64>, moves: &Moves) {
        let n = balance.work.count();
        let w = compliance(self.turns, balance.work);
        for held in moves.points(balance) {
            for pose in 0..6 {
                let (shift, turn) = unit(pose);
                let moved = shift + turn.cross(&(held.on_needle - grip));
                let turned = |axis: usize| turn.dot(&held.frame[axis].cross(&held.force));
                for axis in 0..3 {
                    let along = held.frame[axis];
                    let row = held.row + axis;
                    self.change[n * pose + row] = match held.law {
                        _ if w[row * (n + 1)] == 0.0 => 0.0,
                        Law::Slides if axis == 0 => {
                            let inward = -held.force.dot(&held.frame[1]);
                            turned(0) + held.curvature * inward * along.dot(&moved)
                        }
                        Law::Sticks | Law::Slides => -along.dot(&moved),
                        Law::Cut { sticks: true } if axis == 0 => {
                            let off = held.on_needle - held.in_tissue;
                            -along.dot(&moved) - turn.dot(&along.cross(&off))
                        }
                        Law::Cut { .. } => turned(axis),
                    };
                }
            }
        }
    }

    /// Right-hand sides of what ends of threads do to their rows. The length of a thread that lies on a body is one in the frame of that: as
    /// the body moves, the other ends of the straight pieces move the other way in it.
    fn load_threads(&mut self, balance: &Balance, pulls: &[Pull]) {
        let n = balance.work.count();
        let (w, modes) = (
            compliance(self.turns, balance.work),
            balance.state.grasp.modes(),
        );
        for pull in pulls {
            for pose in 0..6 {
                let (shift, turn) = unit(pose);
                let moved = shift + turn.cross(&pull.arm);
                let rows = &mut self.change[n * pose..n * (pose + 1)];
                pull.rows.visit(|row, direction| {
                    // One tool may hold both ends of a strand.
                    if modes[row] == Mode::Held && w[row * (n + 1)] > 0.0 {
                        rows[row] += direction.dot(&moved);
                    }
                });
            }
        }
    }

    /// Right-hand sides of what forces of threads do to the tissue as they turn with a body that these lie on.
    fn load_turned(&mut self, work: &BalanceWork, pulls: &[Pull]) {
        let n = work.count();
        self.swung[..6 * n].fill(0.0);
        if pulls.iter().all(|pull| pull.on_body.is_none()) {
            return;
        }
        for pose in 3..6 {
            let swung = &mut self.swung[n * pose..n * (pose + 1)];
            for (way, force) in turned(pulls, unit(pose).1) {
                visit_terms(work, |row, anchor, direction| {
                    swung[row] += direction.dot(&(work.system.between(anchor, way) * force));
                });
            }
            // Where it has a body to turn a tool has no shape, and no J.
            let change = &mut self.jacobian[n * pose..n * (pose + 1)];
            change.copy_from_slice(swung);
            for (row, scale) in &self.follow {
                change[*row] *= -scale;
            }
            for (_, touched) in &self.touched {
                touched.follow(change);
            }
            for gripped in &work.jaws.points {
                gripped.follow(change);
            }
            let own = self.change[n * pose..n * (pose + 1)].iter_mut();
            for ((own, change), free) in own.zip(change).zip(&self.free) {
                *own += if *free { 0.0 } else { *change };
            }
        }
    }

    /// Right-hand sides of what a tool that rubs, and a needle that lies on a surface, does to its rows.
    fn load_rough(&mut self, balance: &Balance, grip: &Vector3<f64>, moves: &Moves) {
        let n = balance.work.count();
        let own = |of: &&(Owner, Touched)| moves.has(of.0);
        for (_, touched) in self.touched.iter().filter(own) {
            for pose in 0..6 {
                let (shift, turn) = unit(pose);
                let load = touched.load(grip, &shift, &turn);
                self.change[n * pose + touched.row..][..3].copy_from_slice(&load);
            }
        }
    }

    /// Right-hand sides of what jaws do to their rows.
    fn load_jaws(&mut self, balance: &Balance, grip: &Vector3<f64>, moves: &Moves) {
        let n = balance.work.count();
        for point in moves.gripped(balance.work) {
            for pose in 0..6 {
                let (shift, turn) = unit(pose);
                let load = point.load(grip, &shift, &turn);
                let rows = &mut self.change[n * pose + point.row..][..3];
                for ((row, load), free) in rows.iter_mut().zip(load).zip(&self.free[point.row..]) {
                    *row = if *free { 0.0 } else { load };
                }
            }
        }
    }

    /// Adds what the points of needles and jaws, and vertices that a rough tool touches, do to the wrench.
    fn add_points(
        &self,
        balance: &Balance,
        grip: &Vector3<f64>,
        moves: &Moves,
        tangent: &mut Matrix6<f64>,
    ) {
        let n = balance.work.count();
        let w = compliance(self.turns, balance.work);
        let of_needles = moves.points(balance);
        let of_needles = of_needles.map(|held| {
            let rows = (held.row, held.frame, [0.0; 3]);
            (rows, held.in_tissue, held.force)
        });
        let of_tools = self.touched.iter().filter(|of| moves.has(of.0));
        let of_tools = of_tools.map(|(_, at)| ((at.row, at.frame, [0.0; 3]), at.at_m, at.force_n));
        let of_jaws = moves.gripped(balance.work);
        let of_jaws = of_jaws.map(|at| ((at.row, at.frame, at.soft), at.at_m, at.force_n));
        let points = of_needles.chain(of_tools).chain(of_jaws);
        for ((first, frame, soft), in_tissue, held_n) in points {
            let arm = in_tissue - grip;
            for pose in 0..6 {
                let (shift, _) = unit(pose);
                let own = &self.change[n * pose..n * (pose + 1)];
                let (mut force, mut moved) = (Vector3::zeros(), Vector3::zeros());
                for (axis, direction) in frame.iter().enumerate() {
                    let row = first + axis;
                    force += direction * own[row];
                    let column = &w[n * row..n * (row + 1)];
                    let swung = self.swung[n * pose + row];
                    moved -= direction * (product(column, own) - soft[axis] * own[row] - swung);
                }
                let moment = arm.cross(&force) - (moved - shift).cross(&held_n);
                add(tangent, pose, &force, &moment);
            }
        }
    }

    /// Adds what ends of threads do to the wrench.
    fn add_threads(&self, work: &BalanceWork, pulls: &[Pull], tangent: &mut Matrix6<f64>) {
        let n = work.count();
        for pull in pulls {
            for pose in 0..6 {
                let (shift, turn) = unit(pose);
                let own = &self.change[n * pose..n * (pose + 1)];
                let mut force = Vector3::zeros();
                pull.rows
                    .visit(|row, direction| force -= direction * own[row]);
                let arm = match pull.on_body {
                    None => turn.cross(&pull.arm),
                    Some(way) => {
                        force += turn.cross(&pull.force);
                        let moved = way.map(|(way, sign)| {
                            let turned = turned(pulls, turn);
                            let swung =
                                turned.map(|(by, force)| work.system.between(way, by) * force);
                            (moved(work, way, own) + swung.sum::<Vector3<f64>>()) * sign
                        });
                        moved.unwrap_or_default() - shift
                    }
                };
                let moment = pull.arm.cross(&force) + arm.cross(&pull.force);
                add(tangent, pose, &force, &moment);
            }
        }
    }

    /// Factors the derivative of a balance, with how needles give way that bodies press on and nobody holds: that is found first, with
    /// them at rest, as what turns with them does not give way.
    pub fn factor(&mut self, balance: &mut Balance) {
        balance.work.needles.responses.fill(None);
        let count = balance.state.each.len();
        if (0..count).any(|needle| balance.responds(needle)) {
            balance.hold_loose(true);
            self.factor_rows(balance);
            for needle in 0..count {
                if !balance.responds(needle) {
                    continue;
                }
                let moves = Moves {
                    needle: &|other| other == needle,
                    tool: None,
                    jaws: None,
                    bar: None,
                };
                let rows = |centre: &Vector3<f64>| -self.differentiate(balance, centre, moves, &[]);
                let response = balance.response(needle, rows);
                balance.work.needles.responses[needle] = response;
            }
            balance.hold_loose(false);
        }
        self.factor_rows(balance);
    }

    /// Stiffness of every needle against its slide, and of all jaws against being pulled on \[N/m\]: if all stuck, and as it is.
    pub fn report_slides(&mut self, balance: &mut Balance, samples: &[ToolSample]) {
        let count = balance.state.each.len();
        for needle in 0..count {
            let grip = balance.grip_of(needle, samples);
            let twist = slide_twist(&balance.curve(needle), &grip);
            let moves = Moves {
                needle: &|other| other == needle,
                tool: None,
                jaws: None,
                bar: None,
            };
            let derivative = self.differentiate(balance, &grip, moves, &[]);
            let out = &mut balance.report.needles_mut(count)[needle];
            out.stiffness_n_per_m[1] = -twist.dot(&(derivative * twist));
        }
        self.report_jaws(balance);
        for needle in 0..count {
            let sticking = self.sticking(balance.work, needle);
            balance.report.needles_mut(count)[needle].stiffness_n_per_m[0] = sticking;
        }
    }

    /// The same of jaws; where all of their points stick the two are one.
    fn report_jaws(&mut self, balance: &mut Balance) {
        let count = balance.sources.jaws.len();
        for jaws in 0..count {
            let report = balance.report.jaws_mut(count)[jaws];
            let (Some(pose), true) = (balance.state.jaws[jaws].pose, report.points > 0) else {
                continue;
            };
            let away = Vector3::from(report.away);
            let moves = Moves {
                needle: &|_| false,
                tool: None,
                jaws: Some(jaws),
                bar: None,
            };
            let derivative = self.differentiate(balance, &pose.translation.vector, moves, &[]);
            let now = -away.dot(&(derivative.fixed_view::<3, 3>(0, 0) * away));
            balance.report.jaws_mut(count)[jaws].stiffness_n_per_m = [now; 2];
        }
        for jaws in 0..count {
            let report = balance.report.jaws_mut(count)[jaws];
            if report.slipping > 0 {
                let sticking = self.sticking_jaws(balance.work, jaws, &report.away.into());
                balance.report.jaws_mut(count)[jaws].stiffness_n_per_m[0] = sticking;
            }
        }
    }

    /// Stiffness of jaws against a way in a direction if nothing slipped, other rows left out \[N/m\].
    fn sticking_jaws(&mut self, work: &BalanceWork, jaws: usize, away: &Vector3<f64>) -> f64 {
        let own = work.jaws.points.iter().filter(|point| point.jaws == jaws);
        let (all, n) = (work.count(), 3 * own.clone().count());
        let Some(first) = own.clone().map(|point| point.row).min() else {
            return 0.0;
        };
        let w = work.system.compliance(all);
        let columns = self.matrix[..n * n].chunks_exact_mut(n);
        for (column, from) in columns.zip(w[first * all..].chunks_exact(all)) {
            column.copy_from_slice(&from[first..first + n]);
        }
        let rhs = &mut self.change[..n];
        for point in own {
            for (axis, along) in point.frame.iter().enumerate() {
                rhs[point.row - first + axis] = along.dot(away);
            }
        }
        // What the rows are to move by, and again as weights of their forces.
        self.jacobian[..n].copy_from_slice(rhs);
        regularise(&mut self.matrix[..n * n], n);
        self.lu.factor(&mut self.matrix[..n * n], n);
        self.lu.solve(&self.matrix[..n * n], n, rhs, 1);
        product(&self.jacobian[..n], &self.change[..n])
    }

    /// Stiffness against the uniform slide of a needle if nothing slid \[N/m\].
    fn sticking(&mut self, work: &BalanceWork, needle: usize) -> f64 {
        // Of the needle's own rows; others do not matter much.
        let n = 3 * work.needles.points.len();
        if n == 0 {
            return 0.0;
        }
        let all = work.count();
        let w = work.system.compliance(all);
        for (column, from) in self
            .matrix
            .chunks_exact_mut(n.max(1))
            .zip(w.chunks_exact(all))
        {
            column.copy_from_slice(&from[..n]);
        }
        let rhs = &mut self.change[..n];
        rhs.fill(0.0);
        let mut any = false;
        for point in work
            .needles
            .points
            .iter()
            .filter(|point| point.needle == needle)
        {
            any = true;
            if friction_of(work, point).is_some() {
                // What lies on the surface slips before it holds anything.
                for axis in 0..3 {
                    free(&mut self.matrix, n, point.first_row + axis);
                }
                continue;
            }
            rhs[point.first_row] = f64::from(u8::from(w[point.first_row * (all + 1)] > 0.0));
            if point.what == What::Cut {
                for axis in 1..3 {
                    free(&mut self.matrix, n, point.first_row + axis);
                }
            }
        }
        if !any {
            return 0.0;
        }
        regularise(&mut self.matrix[..n * n], n);
        self.lu.factor(&mut self.matrix[..n * n], n);
        self.lu.solve(&self.matrix[..n * n], n, rhs, 1);
        let along = work
            .needles
            .points
            .iter()
            .filter(|point| point.needle == needle);
        along.map(|point| self.change[point.first_row]).sum()
    }
}

/// What a row's own compliance is raised by: rows that say the same share the force, as in a solve.
const REGULAR: f64 = 1e-11;
/// A row that differs by less than this part of its compliance from others says the same.
const SAME: f64 = 1e-9;

/// C (K - G)^-1 C' of the rows of the balance, G where normals turn, (n x n).
fn compliance(turns: bool, work: &BalanceWork) -> &[f64] {
    let n = work.count();
    match work.tools.known_turning().filter(|_| turns) {
        Some(turning) => &turning.compliance[..n * n],
        None => work.system.compliance(n),
    }
}

/// Visits the rows, each with its anchors and its direction at these.
fn visit_terms(work: &BalanceWork, mut visit: impl FnMut(usize, usize, Vector3<f64>)) {
    let set = &work.set;
    for (row, single) in set.rows.iter().enumerate() {
        visit(row, single.anchor as usize, single.direction.into());
    }
    for (row, spread) in set.spread.iter().enumerate() {
        let (first, count) = (spread.terms.0 as usize, spread.terms.1 as usize);
        for term in &set.terms[first..first + count] {
            let row = set.rows.len() + row;
            visit(row, term.anchor as usize, term.direction.into());
        }
    }
}

/// By how much a change of all multipliers moves an anchor or a way. The normals of smooth tools do not turn here.
fn moved(work: &BalanceWork, at: usize, change: &[f64]) -> Vector3<f64> {
    let mut moved = Vector3::zeros();
    visit_terms(work, |row, anchor, direction| {
        moved -= work.system.between(at, anchor) * direction * change[row];
    });
    moved
}

/// What the forces on tissue of threads that lie on a body change by as that turns, each with its way.
fn turned(pulls: &[Pull], turn: Vector3<f64>) -> impl Iterator<Item = (usize, Vector3<f64>)> {
    pulls.iter().filter_map(move |pull| {
        let (way, sign) = pull.on_body??;
        Some((way, turn.cross(&pull.force) * -sign))
    })
}

/// Adds a column's force and moment.
fn add(tangent: &mut Matrix6<f64>, pose: usize, force: &Vector3<f64>, moment: &Vector3<f64>) {
    for axis in 0..3 {
        tangent[(axis, pose)] += force[axis];
        tangent[(3 + axis, pose)] += moment[axis];
    }
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Whether no row of a Cholesky factor (n x n) is almost what others say.
fn is_regular(factor: &[f64], n: usize) -> bool {
    (0..n).all(|row| {
        let before = factor[row..n * row].iter().step_by(n.max(1));
        let pivot = factor[row * (n + 1)].powi(2);
        pivot > SAME * (pivot + before.map(|entry| entry * entry).sum::<f64>())
    })
}

/// Rows on nodes that cannot move keep their force, and rows that repeat others do no harm.
fn regularise(matrix: &mut [f64], n: usize) {
    for row in 0..n {
        if matrix[row * (n + 1)] == 0.0 {
            free(matrix, n, row);
        } else {
            matrix[row * (n + 1)] *= 1.0 + REGULAR;
        }
    }
}

/// Leaves a row without force.
fn free(matrix: &mut [f64], n: usize, row: usize) {
    for other in 0..n {
        matrix[n * row + other] = 0.0;
        matrix[n * other + row] = 0.0;
    }
    matrix[n * row + row] = 1.0;
}

fn unit(pose: usize) -> (Vector3<f64>, Vector3<f64>) {
    let along = |axis: usize| Vector3::ith(axis, 1.0);
    if pose < 3 {
        (along(pose), Vector3::zeros())
    } else {
        (Vector3::zeros(), along(pose - 3))
    }
}

/// Points of needles that lie on a surface and press.
fn lying<'a>(balance: &'a Balance) -> impl Iterator<Item = (Owner, Touched)> + 'a {
    let each = balance.work.needles.points.iter().enumerate();
    each.filter_map(move |(index, point)| {
        let friction = friction_of(balance.work, point)?;
        let on_needle_m = balance.curve(point.needle).at(point.alpha);
        let touched = pressing(balance, (index, point.first_row), on_needle_m, friction)?;
        Some((Owner::Needle(point.needle), touched))
    })
}

/// Points of bars that press.
fn leaning<'a>(balance: &'a Balance) -> impl Iterator<Item = (Owner, Touched)> + 'a {
    balance.work.bars.points.iter().filter_map(move |point| {
        let place = (point.anchor, point.first_row);
        let touched = pressing(balance, place, point.on_bar_m, point.friction)?;
        Some((Owner::Bar(point.bar), touched))
    })
}

/// A point with the rows of a cone, by its anchor and the first of these, and where what presses on it is \[m\]; nothing if that does
/// not press.
fn pressing(
    balance: &Balance,
    (anchor, row): (usize, usize),
    on_it_m: Vector3<f64>,
    friction: f64,
) -> Option<Touched> {
    let (work, grasp) = (&*balance.work, &balance.state.grasp);
    if grasp.lambda()[row] <= 0.0 {
        return None;
    }
    let frame = [0, 1, 2].map(|axis| Vector3::from(work.set.rows[row + axis].direction));
    let slips = friction == 0.0 || grasp.modes()[row + 1] == Mode::Slipping;
    let slipped = slips.then(|| (balance.slipped(row), friction));
    let at_m = balance.position_of(&work.set.anchors[anchor]);
    let force_n = grasp.force_on(anchor);
    Some(Touched::lying(
        (row, frame),
        (at_m, on_it_m),
        force_n,
        slipped,
    ))
}

fn held(balance: &Balance, index: usize, point: &Point, in_tissue: Vector3<f64>) -> Held {
    let (sources, grasp) = (balance.sources, &balance.state.grasp);
    let state = &balance.state.each[point.needle];
    let curve = sources.needles[point.needle].needle.at(&state.pose);
    let bound = grasp.modes()[point.first_row] != Mode::Held;
    let law = match (point.what, state.tip) {
        (What::Holding | What::Touch(_), _) => Law::Sticks,
        (What::Crossing(place), _) => {
            let frictionless = state
                .holds
                .get(place)
                .is_none_or(|hold| hold.limit_n == 0.0);
            if bound || frictionless {
                Law::Slides
            } else {
                Law::Sticks
            }
        }
        (What::Cut, Tip::Inside { cut: Some(cut) }) => Law::Cut {
            sticks: cut.pressed && !bound,
        },
        (What::Cut, _) => Law::Cut { sticks: false },
    };
    // Where it has slid to.
    let alpha = match point.what {
        What::Crossing(place) => state
            .history
            .crossings()
            .get(place)
            .map_or(point.alpha, |crossing| crossing.alpha),
        _ => point.alpha,
    };
    Held {
        row: point.first_row,
        frame: curve.frame_at(alpha),
        on_needle: curve.at(alpha),
        in_tissue,
        force: grasp.force_on(index),
        curvature: curve.curvature_at(alpha),
        law,
    }
}

/// The uniform slide of a needle as a twist of its grip per metre: linear, then angular. One of several segments slides as its
/// middle does.
pub(crate) fn slide_twist(curve: &Curve, grip: &Vector3<f64>) -> Vector6<f64> {
    let curve = &curve.middle_piece();
    let turn = curve.binormal() * curve.curvature;
    let shift = curve.tangent + turn.cross(&(grip - curve.start));
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}
