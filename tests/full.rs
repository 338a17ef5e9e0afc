//! Whether tests take their long forms: `cargo xtask test --full` asks for them.

/// `SUTURA_FULL=1`.
pub fn full() -> bool {
    std::env::var_os("SUTURA_FULL").is_some_and(|value| value == "1")
}
