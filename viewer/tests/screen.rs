//! A real window, on a virtual screen.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longest that the window may take.
const PATIENCE: Duration = Duration::from_secs(120);

/// An X server without a screen, on a display that was free.
struct Screen {
    server: Child,
    display: String,
}

impl Screen {
    fn start() -> Self {
        let server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1280x720x24", "-nolisten", "tcp"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let mut server = server.expect("Xvfb cannot be started; remedy: install it, on Debian with `apt-get install xvfb` or by ./scripts/setup.sh");
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let number: u32 = line.trim().parse().expect("Xvfb tells the number of its display");
        Self { server, display: format!(":{number}") }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// The program on this screen, with nothing remembered.
fn viewer(screen: &Screen) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stein-viewer"));
    let home = Path::new(env!("CARGO_TARGET_TMPDIR")).join("home");
    std::fs::create_dir_all(&home).unwrap();
    command.env("DISPLAY", &screen.display).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command.env("XDG_DATA_HOME", &home).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// Its exit code and what it said.
fn ended(mut child: Child) -> (Option<i32>, String) {
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > PATIENCE {
            child.kill().unwrap();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn a_window_opens_shows_a_frame_and_closes() {
    let screen = Screen::start();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../testdata/anim/shot.0000.exr");
    let child = viewer(&screen).arg(file).args(["--method=gem", "--exit-after-frames=5"]).spawn().unwrap();
    let (code, said) = ended(child);
    assert_eq!(code, Some(0), "{said}");
}

#[test]
fn without_a_screen_it_says_what_to_do() {
    let screen = Screen { server: Command::new("true").spawn().unwrap(), display: String::new() };
    let child = viewer(&screen).env_remove("DISPLAY").spawn().unwrap();
    let (code, said) = ended(child);
    assert_eq!(code, Some(4), "{said}");
    assert!(said.contains("remedy:") && said.contains("--screenshot"), "{said}");
}
