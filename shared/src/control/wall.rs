//! A virtual wall and a virtual coupling: useful without a host.
