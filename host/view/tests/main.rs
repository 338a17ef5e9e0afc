//! All tests of the page's server and format, in one binary.

mod clients;
mod commands;
mod connections;
mod format;
mod guard;
mod pictures;
mod support;
mod threads;
