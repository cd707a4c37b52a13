//! Flags of `signing`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// Commands on keys.
#[derive(Debug, Subcommand)]
pub enum SigningCommand {
    /// Makes a key from the system's random numbers, in a new file that only its owner can read.
    Key {
        /// The file to write.
        file: PathBuf,
    },
    /// Sends a vehicle the key of link.signing (SETUP_SIGNING), or removes its key.
    ///
    /// The key crosses the link in the clear, unless the link is encrypted: do this over USB or a
    /// cable. The vehicle must be disarmed. Exit code 3: it did not sign afterwards.
    Setup(SetupArgs),
}

/// Flags of `signing setup`.
#[derive(Debug, Args)]
pub struct SetupArgs {
    /// Connection to the vehicle: udpin:HOST:PORT, udpout:, tcp:, tcpin: or serial:DEVICE:BAUD.
    #[arg(long, value_name = "URL")]
    pub connect: Option<String>,
    /// System id of the vehicle, where several are on the link.
    #[arg(long, value_name = "ID")]
    pub system: Option<u8>,
    /// The vehicle's present key, which that of link.signing replaces.
    #[arg(long, value_name = "FILE")]
    pub old_key: Option<PathBuf>,
    /// Removes the key: the vehicle no longer signs, and accepts every sender.
    #[arg(long, conflicts_with = "old_key")]
    pub off: bool,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
}
