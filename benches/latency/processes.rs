//! The two measured processes: the daemon and the echo.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::viewer::Manner;

/// A process that is killed when dropped.
pub struct Process {
    child: Child,
    /// Port on which it listens on loopback.
    pub port: u16,
    /// File with its log output.
    pub log: Option<PathBuf>,
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Process {
    /// Builds and starts the echo.
    pub fn echo(folder: &Path) -> Self {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/latency/echo.c");
        let binary = folder.join("echo");
        let built = Command::new("cc").arg("-O2").arg(&source).arg("-o").arg(&binary).status();
        assert!(built.is_ok_and(|status| status.success()), "cc cannot build {}", source.display());
        let mut child = Command::new(binary).stdout(Stdio::piped()).spawn().expect("the echo");
        let mut line = String::new();
        let out = child.stdout.take().expect("its output");
        BufReader::new(out).read_line(&mut line).expect("its port");
        Self { child, port: line.trim().parse().expect("a port"), log: None }
    }

    /// Starts `PROGRAM daemon` on a free port, with control at `rate_hz`, and with the live view on
    /// another port.
    pub fn daemon(program: &Path, folder: &Path, rate_hz: f64, viewer: Option<Manner>) -> Self {
        let probe = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let port = probe.local_addr().expect("its address").port();
        drop(probe);
        let (config, log) = (folder.join("config.toml"), folder.join("daemon.txt"));
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let text = format!(
            "vehicle = {:?}\ntrajectory = {:?}\nconnect = \"udpin:127.0.0.1:{port}\"\n\
             log_dir = {folder:?}\n[control]\nrate_hz = {rate_hz}\n",
            root.join("config/vehicles/crazyflie.toml"),
            root.join("config/trajectories/hover.toml"),
        );
        std::fs::write(&config, text).expect("the configuration is written");
        let child = Command::new(program)
            .args(["daemon", "--config"])
            .arg(config)
            .args(viewer.map(|_| "--view=127.0.0.1:0"))
            .args(viewer.filter(|manner| *manner == Manner::Sets).map(|_| "--view-write"))
            .stdout(Stdio::null())
            .stderr(File::create(&log).expect("a file for its words"))
            .spawn()
            .expect("the daemon");
        Self { child, port, log: Some(log) }
    }

    /// User and system time so far, s, from the scheduler's total run time: the clock ticks of
    /// `/proc/PID/stat` miss short runs between them.
    pub fn cpu_seconds(&self) -> f64 {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.child.id()));
        let run_time = |thread: PathBuf| -> Option<f64> {
            let schedstat = std::fs::read_to_string(thread.join("schedstat")).ok()?;
            schedstat.split_whitespace().next()?.parse().ok()
        };
        let threads = threads.into_iter().flatten().flatten();
        threads.filter_map(|thread| run_time(thread.path())).sum::<f64>() * 1e-9
    }
}

/// Allows this thread to run on any core again.
pub fn unpin() {
    // SAFETY: plain values; the set is initialised before it is read. The system ignores cores that
    // do not exist.
    unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        (0..64).for_each(|core| libc::CPU_SET(core, &mut set));
        libc::sched_setaffinity(0, size_of_val(&set), &set);
    }
}

/// Pins this process, and those that it starts from now on, to one core.
pub fn pin(core: usize) {
    // SAFETY: plain values; the set is initialised before it is read.
    let pinned = unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        libc::CPU_SET(core, &mut set);
        libc::sched_setaffinity(0, size_of_val(&set), &set)
    };
    assert_eq!(pinned, 0, "cannot pin to core {core}: {}", std::io::Error::last_os_error());
}
