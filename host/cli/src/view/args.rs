//! The options of everything that has a page.

use clap::{Args, ValueEnum};
use std::net::{IpAddr, Ipv4Addr};

/// Where the page is, and who may use it.
#[derive(Args, Clone, Debug)]
pub struct PageArgs {
    /// Port of the page; the next free one of ten.
    #[arg(long, value_name = "PORT", default_value_t = 8421)]
    pub view_port: u16,
    /// Address that the page listens on; other than this machine's own it needs --view-host, and has no encryption.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    pub view_bind: IpAddr,
    /// Name that others write in the page's address, without port.
    #[arg(long, value_name = "NAME")]
    pub view_host: Vec<String>,
    /// Who may take the controls: pages on this machine, or any that has the key.
    #[arg(long, value_name = "WHO", value_enum, default_value_t = Control::Here)]
    pub view_control: Control,
    /// Opens the page in a browser.
    #[arg(long)]
    pub open: bool,
    /// Live channels for Foxglove, Lichtblick and PlotJuggler at ws://127.0.0.1:8765: /tool, /solve, /gauges, /scene. For this
    /// machine alone and to be read only; there is no key: whoever is on this machine may read.
    #[arg(long)]
    pub foxglove: bool,
    /// Port of these channels; 0: any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 8765)]
    pub foxglove_port: u16,
}

/// Who may take the controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Control {
    /// Pages on this machine, also through `ssh -L`.
    Here,
    /// Any that has the key.
    Any,
}
