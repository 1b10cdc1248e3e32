//! A real window, on a virtual screen.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use stein::{Denoiser, Gpu, Method, Preset, gpu::DeviceChoice};
use stein_exr::{BufferSet, BufferSetRequest};
use tempfile::TempDir;
use x11rb::connection::Connection;
use x11rb::protocol::xproto::{
    Atom, AtomEnum, ClientMessageEvent, ConnectionExt, EventMask, InputFocus, KEY_PRESS_EVENT, KEY_RELEASE_EVENT,
    KeyButMask, KeyPressEvent, Keysym, MapState, Window,
};
use x11rb::rust_connection::RustConnection;

/// Between two looks at what is waited for.
const PAUSE: Duration = Duration::from_millis(20);
/// After which a key is pressed again that has come to nothing: the frame may not have been denoised.
const BETWEEN_KEYS: Duration = Duration::from_secs(1);
/// Longest that the window may take.
const PATIENCE: Duration = Duration::from_secs(120);

/// An X server without a screen, on a display that was free.
struct Screen {
    server: Child,
    display: String,
    /// Where programs on it remember things.
    home: TempDir,
}

impl Screen {
    fn start() -> Self {
        let server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1280x720x24", "-nolisten", "tcp"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let mut server = server.expect(
            "Xvfb cannot be started; remedy: install it, on Debian with `apt-get install \
                                        xvfb` or by ./scripts/setup.sh",
        );
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let number: u32 = line.trim().parse().expect("Xvfb tells the number of its display");
        Self { server, display: format!(":{number}"), home: tempfile::tempdir().unwrap() }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

fn testdata(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../testdata").join(name)
}

/// The program on this screen, with nothing remembered.
fn viewer(screen: &Screen) -> Command {
    viewer_of(screen, screen.home.path())
}

/// The program on this screen, with what is remembered in a folder.
fn viewer_of(screen: &Screen, home: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stein-viewer"));
    command.env("DISPLAY", &screen.display).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command
        .env("XDG_DATA_HOME", home)
        .env("STEIN_CACHE", "")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
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
    let child = viewer(&screen)
        .arg(testdata("anim/shot.0000.exr"))
        .args(["--method=gem", "--exit-after-frames=5"])
        .spawn()
        .unwrap();
    let (code, said) = ended(child);
    assert_eq!(code, Some(0), "{said}");
}

#[test]
fn without_a_screen_it_says_what_to_do() {
    let screen = Screen {
        server: Command::new("true").spawn().unwrap(),
        display: String::new(),
        home: tempfile::tempdir().unwrap(),
    };
    let child = viewer(&screen).env_remove("DISPLAY").spawn().unwrap();
    let (code, said) = ended(child);
    assert_eq!(code, Some(4), "{said}");
    assert!(said.contains("remedy:") && said.contains("--screenshot"), "{said}");
}

/// The only window on a screen, as another program sees it.
struct Seen {
    connection: RustConnection,
    window: Window,
}

impl Seen {
    /// Waits until there is a window, and has keys go to it, as a window manager would.
    fn wait(screen: &Screen) -> Self {
        let (connection, number) = RustConnection::connect(Some(&screen.display)).unwrap();
        let root = connection.setup().roots[number].root;
        let is_visible = |window: &Window| {
            // It may have gone meanwhile.
            let attributes = connection.get_window_attributes(*window).unwrap().reply();
            attributes.is_ok_and(|attributes| attributes.map_state == MapState::VIEWABLE)
                && !title_of(&connection, *window).is_empty()
        };
        let window = until("a window", || {
            connection.query_tree(root).unwrap().reply().unwrap().children.into_iter().find(is_visible)
        });
        connection.set_input_focus(InputFocus::PARENT, window, x11rb::CURRENT_TIME).unwrap().check().unwrap();
        Self { connection, window }
    }

    fn title(&self) -> String {
        title_of(&self.connection, self.window)
    }

    /// Presses and releases the key of a letter, with modifiers.
    fn press(&self, letter: char, state: KeyButMask) {
        let setup = self.connection.setup();
        let (first, count) = (setup.min_keycode, setup.max_keycode - setup.min_keycode + 1);
        let mapping = self.connection.get_keyboard_mapping(first, count).unwrap().reply().unwrap();
        let has = |symbols: &[Keysym]| symbols.contains(&letter.into());
        let place = mapping.keysyms.chunks(mapping.keysyms_per_keycode.into()).position(has).unwrap();
        for response_type in [KEY_PRESS_EVENT, KEY_RELEASE_EVENT] {
            let event = KeyPressEvent {
                response_type,
                detail: first + u8::try_from(place).unwrap(),
                sequence: 0,
                time: x11rb::CURRENT_TIME,
                root: setup.roots[0].root,
                event: self.window,
                child: x11rb::NONE,
                root_x: 0,
                root_y: 0,
                event_x: 0,
                event_y: 0,
                state,
                same_screen: true,
            };
            self.connection.send_event(false, self.window, EventMask::KEY_PRESS, event).unwrap().check().unwrap();
        }
    }

    /// Presses a key, again where it comes to nothing, until there is a file.
    fn press_for(&self, letter: char, state: KeyButMask, file: &Path) {
        until(&file.display().to_string(), || {
            self.press(letter, state);
            let start = Instant::now();
            while !file.exists() && start.elapsed() < BETWEEN_KEYS {
                std::thread::sleep(PAUSE);
            }
            file.exists().then_some(())
        });
    }

    /// Asks the window to close, as its button would.
    fn close(&self) {
        let [protocols, delete] =
            [b"WM_PROTOCOLS".as_slice(), b"WM_DELETE_WINDOW"].map(|name| atom(&self.connection, name));
        let message = ClientMessageEvent::new(32, self.window, protocols, [delete, x11rb::CURRENT_TIME, 0, 0, 0]);
        self.connection.send_event(false, self.window, EventMask::NO_EVENT, message).unwrap().check().unwrap();
    }
}

fn atom(connection: &RustConnection, name: &[u8]) -> Atom {
    connection.intern_atom(false, name).unwrap().reply().unwrap().atom
}

/// Empty where it has none.
fn title_of(connection: &RustConnection, window: Window) -> String {
    let name = connection
        .get_property(false, window, atom(connection, b"_NET_WM_NAME"), AtomEnum::ANY, 0, 1024)
        .unwrap()
        .reply();
    name.map_or_else(|_| String::new(), |name| String::from_utf8_lossy(&name.value).into_owned())
}

/// What there is at last.
fn until<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "no {what}");
        std::thread::sleep(PAUSE);
    }
}

/// Where no desktop has dialogs of its own, a program of this name shows them; this one answers at once: a frame, or a
/// file in `folder`, some without their endings.
fn answer_dialogs(folder: &Path) {
    let script = format!(
        "#!/bin/sh\n\
         echo \"$*\" >> '{folder}/asked'\n\
         case \"$*\" in\n\
         *--save*OpenEXR*) echo '{folder}/result' ;;\n\
         *--save*.result.png*) echo '{folder}/layer' ;;\n\
         *--save*PNG*) echo '{folder}/view' ;;\n\
         *--save*TOML*) echo '{folder}/own.toml' ;;\n\
         *TOML*) echo '{folder}/other.toml' ;;\n\
         *OpenEXR*) echo '{frame}' ;;\n\
         esac\n",
        folder = folder.display(),
        frame = testdata("anim/shot.0001.exr").display(),
    );
    let program = folder.join("zenity");
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn keys_ask_for_files_and_what_is_answered_is_opened_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    answer_dialogs(folder.path());
    let nlm =
        Method::all().into_iter().find(|method| method.name() == "nlm").unwrap().with_parameter("cut", 0.1).unwrap();
    std::fs::write(path("own.params"), nlm.to_toml(Preset::Default)).unwrap();
    let screen = Screen::start();
    let mut command = viewer_of(&screen, folder.path());
    let programs = std::env::join_paths(
        [folder.path().to_owned()].into_iter().chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    )
    .unwrap();
    // No desktop answers.
    command.env("PATH", programs).env("DBUS_SESSION_BUS_ADDRESS", format!("unix:path={}", path("no-bus").display()));
    let child = command.arg("--params").arg(path("own.params")).arg("--radius=2").spawn().unwrap();
    let window = Seen::wait(&screen);
    assert_eq!(window.title(), "Stein");

    let control = KeyButMask::CONTROL;
    until("frame of the dialog", || {
        window.press('o', control);
        std::thread::sleep(Duration::from_secs(1));
        (window.title() == "shot.0001.exr - Stein").then_some(())
    });
    // What the command line said of the parameters: the file, but for the radius.
    window.press_for('p', control, &path("own.toml"));
    let (method, preset) = Method::read_toml(&path("own.toml")).unwrap();
    assert_eq!((method, preset), (nlm.with_parameter("window_radius", 2).unwrap(), Preset::Default));
    window.press_for('s', control, &path("result.exr"));
    let read = |input: PathBuf| BufferSet::read(&BufferSetRequest { input, ..Default::default() }).unwrap();
    let frame = read(testdata("anim/shot.0001.exr")).to_frame().unwrap().0;
    let estimate = Denoiser::new(&Gpu::open(&DeviceChoice::Auto).unwrap(), method).unwrap().denoise(&frame).unwrap();
    assert!(read(path("result.exr")).color().mean == estimate.color, "other bits than the library's");
    window.press_for('e', control, &path("view.png"));
    window.press_for('e', control | KeyButMask::SHIFT, &path("layer.png"));
    let size = |name: &str| {
        let reader = png::Decoder::new(BufReader::new(std::fs::File::open(path(name)).unwrap())).read_info().unwrap();
        (reader.info().width, reader.info().height)
    };
    assert_eq!(size("layer.png"), (frame.extent().width, frame.extent().height));
    assert!(size("view.png").0 > 400, "{:?}", size("view.png"));
    // Loaded from a file, they are in use, and written again.
    std::fs::write(path("other.toml"), "method = \"gem\"\n").unwrap();
    until("parameters of gem", || {
        window.press('p', control | KeyButMask::SHIFT);
        std::thread::sleep(Duration::from_millis(300));
        window.press('p', control);
        std::thread::sleep(Duration::from_millis(300));
        (Method::read_toml(&path("own.toml")).unwrap().0.name() == "gem").then_some(())
    });

    window.close();
    let (code, said) = ended(child);
    assert_eq!(code, Some(0), "{said}");
    // The next start knows the file, and what was changed of the method that is not in use any more.
    let remembered = std::fs::read_to_string(path("stein-viewer/app.ron")).unwrap();
    assert!(remembered.contains("shot.0001.exr") && remembered.contains("cut = 0.1"), "{remembered}");
    let asked = std::fs::read_to_string(path("asked")).unwrap();
    for suggested in ["shot.0001.denoised.exr", "shot.0001.view.png", "shot.0001.result.png", "nlm.toml"] {
        assert!(asked.contains(&format!("--filename {suggested}")), "{suggested}: {asked}");
    }
}
