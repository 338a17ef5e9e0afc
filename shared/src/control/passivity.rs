//! What the console has given and taken: a passivity observer, and what it lets through.
