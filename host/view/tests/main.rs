//! All tests of the page's server and format, in one binary.

mod clients;
mod commands;
mod guard;
mod support;
