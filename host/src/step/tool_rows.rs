//! A tool's rows for the console: a small linear complementarity problem that predicts its wrench near the balance,
//! switches of what touches, sticks and slips included.

/// Most rows of one tool that a console is given.
pub const MAX_TOOL_ROWS: usize = 24;

/// Rows of one tool at a balance: `delta = delta_m + J dq + W (lambda - lambda_n)`, and
/// 0 <= lambda _|_ delta >= 0. The wrench changes by `M dq + J' (lambda - lambda_n)`, and its skew part by
/// the moment as in the tangent. While no row switches that is the tangent: with a the rows that touch,
/// its symmetric part is `M - J_a' W_aa^-1 J_a`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolRows {
    /// Which tool.
    pub tool: u8,
    /// How many there are. Touching rows come first, the largest multiplier foremost, then the nearest
    /// others.
    pub count: usize,
    /// Whether J and W know that normals turn. Not so where tissue that is held by the forces instead of
    /// the tool would slip, deep in it: there W would not be positive definite. M makes up for it as
    /// long as no row switches.
    pub turning: bool,
    /// What each row may do. The tangents of a cone follow its normal.
    pub kind: [ToolRowKind; MAX_TOOL_ROWS],
    /// The node each row acts on: the same row from step to step.
    pub id: [u32; MAX_TOOL_ROWS],
    /// Gap \[m\]; 0 where it touches.
    pub delta_m: [f64; MAX_TOOL_ROWS],
    /// Of tangents: how far what it stands for slipped in the last step \[m\]; 0 of others.
    pub slip_m: [f64; MAX_TOOL_ROWS],
    /// Multiplier \[N\], 0 where it does not touch.
    pub lambda_n: [f64; MAX_TOOL_ROWS],
    /// d delta / d pose for left increments of the grip, (count x 6) \[m/m, m/rad\]. Minus a row's
    /// normal and its moment arm, and what the turning of the normals adds.
    pub jacobian: [[f64; 6]; MAX_TOOL_ROWS],
    /// W, upper triangle by rows, (count (count + 1) / 2) \[m/N\].
    pub compliance: [f64; MAX_TOOL_ROWS * (MAX_TOOL_ROWS + 1) / 2],
    /// M: symmetric part of d wrench / d pose with all multipliers held, (6 x 6) \[N/m, N, N m/rad\].
    pub held: [[f64; 6]; 6],
    /// Curvature of the tool's surface \[1/m\]: of a sphere; 0 of others.
    pub curvature_per_m: f64,
    /// Of the balance: as the step reports it.
    pub residual: f64,
}

/// What a row of a tool may do.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum ToolRowKind {
    /// Along a normal, without friction.
    #[default]
    Smooth,
    /// Along a normal with friction; its two tangents follow.
    Normal {
        /// Coulomb's coefficient.
        friction: f64,
    },
    /// Across the normal before: it sticks where delta is 0.
    Tangent,
}

impl ToolRows {
    /// No rows.
    pub const NONE: Self = Self {
        tool: 0,
        count: 0,
        turning: false,
        kind: [ToolRowKind::Smooth; MAX_TOOL_ROWS],
        id: [0; MAX_TOOL_ROWS],
        delta_m: [0.0; MAX_TOOL_ROWS],
        slip_m: [0.0; MAX_TOOL_ROWS],
        lambda_n: [0.0; MAX_TOOL_ROWS],
        jacobian: [[0.0; 6]; MAX_TOOL_ROWS],
        compliance: [0.0; MAX_TOOL_ROWS * (MAX_TOOL_ROWS + 1) / 2],
        held: [[0.0; 6]; 6],
        curvature_per_m: 0.0,
        residual: 0.0,
    };

    /// The same forces here, of tissue that is so many times stiffer.
    pub fn stiffen(&mut self, times: f64) {
        for entry in &mut self.compliance {
            *entry /= times;
        }
        for entry in self.held.iter_mut().flatten() {
            *entry *= times;
        }
    }

    /// W\[i\]\[j\] \[m/N\]; 0 for rows that are not there.
    pub fn compliance_between(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (i.min(j), i.max(j));
        if j >= self.count {
            return 0.0;
        }
        self.compliance[self.count * i - i * i.saturating_sub(1) / 2 - i + j]
    }

    /// Leaves out all but the first `most` rows, which must not touch.
    pub(crate) fn truncate(&mut self, most: usize) {
        if self.count <= most {
            return;
        }
        let whole = *self;
        self.count = most;
        let pairs = (0..most).flat_map(|i| (i..most).map(move |j| (i, j)));
        for (entry, (i, j)) in self.compliance.iter_mut().zip(pairs) {
            *entry = whole.compliance_between(i, j);
        }
    }
}
