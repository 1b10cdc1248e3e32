//! Any bytes as an OpenEXR file: read, assigned and settled into a frame. Either an error that names the file, or a
//! frame of finite values; no panic that is not caught, and no more memory than the fuzzer is told to allow.
#![no_main]

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use libfuzzer_sys::{Corpus, fuzz_target};
use stein::frame::Signal;
use stein_exr::{BufferSet, BufferSetRequest, DenoisedLayers, read_reference, write_denoised};

/// A file in memory, where there is such a place. One for each process: the fuzzer may run several.
static FILE: LazyLock<PathBuf> = LazyLock::new(|| {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    folder.join(format!("stein-fuzz-{}.exr", std::process::id()))
});

/// To compress takes longer than to decompress.
const MOST_PIXELS_WRITTEN: usize = 1 << 12;

/// What a few bytes can become at most is still too much to be settled thousands of times in a second.
const MOST_PIXELS: usize = 1 << 20;

fuzz_target!(
    init: {
        // The fuzzer's hook would end the process for panics that the reader catches, which the decoder behind it has a
        // few of.
        let _ = std::panic::take_hook();
        if std::env::var_os("STEIN_FUZZ_CAUGHT").is_none() {
            std::panic::set_hook(Box::new(|_| {}));
        }
    },
    |bytes: &[u8]| -> Corpus {
        let file = &*FILE;
        let mut written = std::fs::File::create(file).expect("a file");
        written.write_all(bytes).expect("space");
        drop(written);
        let read = std::panic::catch_unwind(|| read(file));
        match read {
            Ok(corpus) => corpus,
            Err(_) => std::process::abort(),
        }
    }
);

/// What can be read can be written, and is what it was.
fn write_and_read_again(set: &BufferSet, file: &Path) {
    if set.extent().pixels() > MOST_PIXELS_WRITTEN {
        return;
    }
    let color = set.color().mean;
    let layers = DenoisedLayers { color: &color, replacements: &[], dropped: &[], extra: &[], attributes: &[] };
    write_denoised(set.clone(), file, &layers).unwrap_or_else(|error| panic!("it cannot be written: {error}"));
    let again = read_reference(file, Some(set.color_layer()).filter(|name| !name.is_empty()))
        .unwrap_or_else(|error| panic!("it was written wrong: {error}"));
    assert_eq!(again.extent, color.extent);
}

fn read(file: &Path) -> Corpus {
    let names_the_file = |error: stein::Error| {
        let text = error.to_string();
        assert!(text.contains("stein-fuzz-") && !error.remedies().is_empty(), "{text}");
    };
    if let Err(error) = read_reference(file, None) {
        names_the_file(error);
    }
    let set = match BufferSet::read(&BufferSetRequest { input: file.to_owned(), ..BufferSetRequest::default() }) {
        Ok(set) => set,
        Err(error) => {
            names_the_file(error);
            return Corpus::Keep;
        }
    };
    if set.extent().pixels() > MOST_PIXELS {
        return Corpus::Reject;
    }
    write_and_read_again(&set, file);
    // Without a usable pixel there is no frame.
    if let Ok((frame, _)) = set.to_frame() {
        let features = frame.features().iter().map(|feature| &feature.signal);
        for signal in std::iter::once(frame.color()).chain(features) {
            let Signal { mean, half_spread, variance_of_mean } = signal;
            let images = [Some(mean), half_spread.as_ref(), variance_of_mean.as_ref()];
            let mut values = images.into_iter().flatten().flat_map(|image| &image.planes).flatten();
            assert!(values.all(|value| value.is_finite()), "a frame holds a value that is not finite");
        }
    }
    Corpus::Keep
}
