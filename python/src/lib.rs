//! The Python package `sutura`: scenes and their solver with numpy in and out.
//!
//! What Python sees is listed in `_sutura`, and typed in `package/sutura/_sutura.pyi`. No array views the solver's memory: results
//! are copied, into fresh arrays or into `out`.

mod array;
mod console;
mod error;
mod report;
mod scene;
mod session;
mod solver;
mod study;

use pyo3::prelude::*;

/// The library behind the package `sutura`.
#[pymodule]
mod _sutura {
    #[pymodule_export]
    use crate::console::{Console, Pose};
    #[pymodule_export]
    use crate::error::{BusyError, ConsoleError, Error, SceneError, SolveError, harmless};
    #[pymodule_export]
    use crate::report::{Contact, Jaws, Needle, Step, Thread};
    #[pymodule_export]
    use crate::scene::Scene;
    #[pymodule_export]
    use crate::session::{replay_session, run_session};
    #[pymodule_export]
    use crate::solver::{Moment, Solver};
    #[pymodule_export]
    use crate::study::{fidelity, merge_tradeoff, stability, tradeoff, tradeoff_cases};

    /// The release of the solver.
    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "Python's name")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
