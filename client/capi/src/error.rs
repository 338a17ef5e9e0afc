//! Codes for C, and the words behind the last one.

use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use sutura_client::Error;

/// Done.
pub const SUTURA_OK: i32 = 0;
/// No pose came in time; not an error.
pub const SUTURA_NO_POSE: i32 = 1;
/// An argument is NULL, not finite or out of range.
pub const SUTURA_BAD_ARGUMENT: i32 = -1;
/// No such port, no permission, or nobody answers on it.
pub const SUTURA_NO_CONSOLE: i32 = -2;
/// Another program has the port, or another host the console.
pub const SUTURA_BUSY: i32 = -3;
/// Console and library are of different releases.
pub const SUTURA_MISMATCH: i32 = -4;
/// The console went away, or takes nothing any more.
pub const SUTURA_GONE: i32 = -5;
/// A defect of the library; the console disarms by itself.
pub const SUTURA_DEFECT: i32 = -6;

/// Why a call is not done.
pub(crate) struct Refusal {
    code: i32,
    message: String,
}

impl Refusal {
    pub fn argument(message: &str) -> Refusal {
        Refusal {
            code: SUTURA_BAD_ARGUMENT,
            message: message.to_owned(),
        }
    }

    pub fn null(what: &str) -> Refusal {
        Refusal::argument(&format!("{what} is NULL"))
    }
}

impl From<Error> for Refusal {
    fn from(error: Error) -> Self {
        let code = match &error {
            Error::NoPort { .. }
            | Error::Permission { .. }
            | Error::Open { .. }
            | Error::NoAnswer { .. }
            | Error::GivenUp { .. } => SUTURA_NO_CONSOLE,
            Error::Busy { .. } | Error::Owned { .. } => SUTURA_BUSY,
            Error::Mismatch { .. } => SUTURA_MISMATCH,
            Error::Unsendable { .. } => SUTURA_BAD_ARGUMENT,
            Error::Gone { .. }
            | Error::Stuck { .. }
            | Error::NoStates { .. }
            | Error::Console { .. } => SUTURA_GONE,
        };
        Refusal {
            code,
            message: format!("{error}; {}", error.help()),
        }
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// Runs a call. Nothing unwinds into C.
pub(crate) fn guarded(call: impl FnOnce() -> Result<i32, Refusal>) -> i32 {
    // What a panic leaves behind is a handle whose locks outlive it, and at worst a place that was not written.
    let outcome = catch_unwind(AssertUnwindSafe(call)).unwrap_or_else(|_| {
        Err(Refusal {
            code: SUTURA_DEFECT,
            message: "a defect of the library: please report it".to_owned(),
        })
    });
    outcome.unwrap_or_else(|refusal| {
        let words = CString::new(refusal.message.replace('\0', " ")).unwrap_or_default();
        // While the thread ends there is no place for it.
        let _ = LAST.try_with(|last| last.replace(words));
        refusal.code
    })
}

/// The words of this thread's last refusal.
pub(crate) fn last() -> *const c_char {
    LAST.try_with(|last| last.borrow().as_ptr())
        .unwrap_or(c"".as_ptr())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::CStr;

    #[test]
    fn a_panic_ends_at_the_border_and_leaves_words() {
        assert_eq!(guarded(|| Err(Refusal::null("x"))), SUTURA_BAD_ARGUMENT);
        let words = || {
            // SAFETY: `last` gives a string of this thread, which calls nothing meanwhile.
            unsafe { CStr::from_ptr(last()) }
                .to_string_lossy()
                .into_owned()
        };
        assert_eq!(words(), "x is NULL");
        assert_eq!(guarded(|| panic!("on purpose")), SUTURA_DEFECT);
        assert!(words().contains("defect"), "{}", words());
    }
}
