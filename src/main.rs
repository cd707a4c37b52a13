//! The `downwash` command.

fn main() {}
