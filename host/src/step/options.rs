//! What a step is asked for besides the tools' poses.
//!
//! Entry point: [`StepOptions`].

/// What a step is asked for; by default nothing but balance and contacts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepOptions {
    /// Vertices whose columns it may compute before it says [`Status::Waiting`](super::Status::Waiting), if not as many as
    /// the model says.
    pub vertices_per_step: Option<usize>,
    /// To how many rows at most it reduces each tool's contact, for [`Workspace::rows`](super::Workspace::rows); 0: it does
    /// not. More than [`MAX_TOOL_ROWS`](super::MAX_TOOL_ROWS) are never given.
    pub most_rows: usize,
    /// Way that a tool may go from its pose while its rows are in use \[m\], (3): those that would switch on it are chosen
    /// first.
    pub ahead_m: [f64; 3],
    /// Way in any direction that it may go besides \[m\]: what is so near is said while the tool is apart, and its columns
    /// are asked for.
    pub reach_m: f64,
    /// Most passes over corotational or hyperelastic tissue, if not as many as the model says.
    pub passes: Option<u32>,
    /// Whether nobody asks what tools with a shape may come to feel: their contacts have no rows, and no tangent while they are apart.
    pub without_tools: bool,
    /// Of how many tools, the first, a tangent is asked for; of all if it is not said. In that of others what
    /// rows answer is missing.
    pub tangents: Option<usize>,
    /// So far around the tip of a needle outside surfaces are looked for \[m\], for
    /// [`NeedleReport::near`](crate::needle::NeedleReport::near); 0: they are not.
    pub tip_reach_m: f64,
    /// Most effort of its solves, if not as much as any step has; for iterations that do not end.
    pub most_effort: Option<f64>,
}

impl StepOptions {
    /// The least, with columns of so many vertices.
    pub const fn with_vertices(most: usize) -> Self {
        Self {
            vertices_per_step: Some(most),
            most_rows: 0,
            ahead_m: [0.0; 3],
            reach_m: 0.0,
            passes: None,
            without_tools: false,
            tangents: None,
            tip_reach_m: 0.0,
            most_effort: None,
        }
    }
}
