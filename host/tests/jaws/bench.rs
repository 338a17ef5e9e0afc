//! Times, printed by hand: `cargo nextest run --release -p sutura-host --run-ignored all --no-capture sixty_rows`.
