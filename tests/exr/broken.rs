//! The corpus of broken files: each is made here, is stored in `testdata/broken`, and is refused with its name, the
//! problem and a remedy.

use std::path::{Path, PathBuf};

use stein::error::Error;
use stein_exr::BufferSet;

use super::draft::{Block, CHANNELS, Draft, HALF, HEIGHT, channel_list, channels, ints};
use super::{folder, request};

/// Environment variable: if it is set, the corpus is written again.
const REMAKE: &str = "STEIN_REMAKE_BROKEN";

struct Broken {
    name: String,
    bytes: Vec<u8>,
    /// Words that the message must have.
    said: &'static str,
}

fn corpus() -> Vec<Broken> {
    let mut corpus = Vec::new();
    let (whole, marks) = Draft::good().bytes();

    // Cut at the beginning of each part of the file, and in its middle.
    for (index, (name, at)) in marks.iter().enumerate() {
        let end = marks.get(index + 1).map_or(whole.len(), |(_, at)| *at);
        let said = match name.as_str() {
            "version" => "first eight bytes",
            "offsets" => "table of offsets",
            block if block.contains("block") => "block",
            _ => "ends in its header",
        };
        let name = name.replace(' ', "_");
        if name != "end_of_the_header" {
            corpus.push(Broken { name: format!("cut_in_{name}"), bytes: whole[..(at + end) / 2].to_vec(), said });
        }
        if name == "offsets" || name == "channels" || name.starts_with("block") {
            corpus.push(Broken { name: format!("cut_before_{name}"), bytes: whole[..*at].to_vec(), said });
        }
    }

    let mut add =
        |name: &str, bytes: Vec<u8>, said: &'static str| corpus.push(Broken { name: name.to_owned(), bytes, said });
    add("empty", Vec::new(), "is empty");
    add("cut_in_magic", whole[..3].to_vec(), "is not an OpenEXR file");
    add("png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x01\0\0\0\x01\x08\0\0\0\0:~\x9bU".to_vec(), "it ends too early");
    add("text", b"openexr\n".to_vec(), "is not an OpenEXR file, nor a PFM or PNG file");

    let mut draft = |name: &str, draft: Draft, said: &'static str| add(name, draft.bytes().0, said);
    draft("version_3", Draft { version: [3, 0, 0, 0], ..Draft::good() }, "version 3");
    draft("flags_unknown", Draft { version: [2, 0, 0x20, 0], ..Draft::good() }, "flags");
    draft("deep", Draft { version: [2, 8, 0, 0], ..Draft::good() }, "deep data");
    draft("deep_type", Draft::good().and("type", "string", "deepscanline".into()), "deep data");

    // Attributes.
    draft("no_channels", Draft::good().without("channels"), "channels");
    draft("no_compression", Draft::good().without("compression"), "compression");
    draft("no_data_window", Draft::good().without("dataWindow"), "data window");
    draft("no_display_window", Draft::good().without("displayWindow"), "display window");
    draft("window_twice", Draft::good().and("dataWindow", "box2i", ints(&[0, 0, 3, 2])), "'dataWindow' twice");
    draft("compression_unknown", Draft::good().with("compression", vec![99]), "number 99");
    draft("compression_htj2k", Draft::good().with("compression", vec![10]), "HTJ2K");
    draft("compression_wide", Draft::good().with("compression", vec![0, 0]), "compression");
    draft(
        "name_without_end",
        Draft::good().and(Box::leak("n".repeat(400).into_boxed_str()), "int", vec![0; 4]),
        "a name that does not end",
    );
    for (name, size, said) in
        [("attribute_negative", -1, "negative size"), ("attribute_huge", i32::MAX, "which takes 2147483647 bytes")]
    {
        let (mut bytes, marks) = Draft::good().and("comments", "string", vec![b'x'; 4]).bytes();
        let at = marks.iter().find(|(name, _)| name == "comments").map(|(_, at)| at + "comments string ".len());
        let at = at.expect("it was added");
        bytes[at..at + 4].copy_from_slice(&i32::to_le_bytes(size));
        corpus.push(Broken { name: name.into(), bytes, said });
    }
    let mut add =
        |name: &str, bytes: Vec<u8>, said: &'static str| corpus.push(Broken { name: name.to_owned(), bytes, said });
    let mut draft = |name: &str, draft: Draft, said: &'static str| add(name, draft.bytes().0, said);

    // Windows: the memory that they claim is never allocated.
    draft("window_of_2_31", Draft::good().window([0, 0, i32::MAX, i32::MAX]), "claims");
    draft("window_overflow", Draft::good().window([i32::MIN, i32::MIN, i32::MAX, i32::MAX]), "claims");
    draft("window_100k", Draft::good().window([0, 0, 99_999, 99_999]), "larger than the file can hold");
    draft("window_100k_in_one_block", tiled(100_000).window([0, 0, 99_999, 99_999]), "larger than the file can hold");
    draft("window_wide", Draft::good().window([0, 0, (1 << 20) - 1, 2]), "larger than the file can hold");
    draft(
        "window_huge_dwab",
        Draft::good().with("compression", vec![9]).window([0, 0, (1 << 20) - 1, 255]),
        "larger than the file can hold",
    );
    draft("window_inverted", Draft::good().window([3, 2, 0, 0]), "which is no pixel");
    draft("window_empty", Draft::good().window([0, 0, -1, 2]), "which is no pixel");
    draft("window_short", Draft::good().with("dataWindow", vec![0; 12]), "no window");
    draft("display_inverted", Draft::good().with("displayWindow", ints(&[3, 2, 0, 0])), "'displayWindow' goes from");

    // Channels.
    draft("channels_none", Draft::good().with("channels", vec![0]), "at least one channel");
    draft("channels_endless", Draft::good().with("channels", channels(&CHANNELS)[..40].to_vec()), "does not end");
    draft(
        "channels_twice",
        Draft::good().with("channels", channels(&["B", "G", "G", "R", "variance.G", "variance.R"])),
        "'G' twice",
    );
    draft("channels_subsampled", Draft::good().with("channels", sampled([2, 2])), "subsampled");
    draft("channels_never_sampled", Draft::good().with("channels", sampled([0, 1])), "subsampled");
    draft("channels_of_unknown_type", Draft::good().with("channels", channel_list(&[("B", 7, [1, 1])])), "type");
    let without_blue = ["G", "R", "halfA.B", "halfA.G", "halfA.R", "halfB.B", "halfB.G", "halfB.R"];
    draft("no_blue", Draft::of(&without_blue), "has no colour");
    draft("half_alone", Draft::of(&["B", "G", "R", "halfA.B", "halfA.G", "halfA.R"]), "half B is missing");
    draft(
        "half_without_blue",
        Draft::of(&["B", "G", "R", "halfA.G", "halfA.R", "halfB.B", "halfB.G", "halfB.R"]),
        "do not match",
    );
    let nan = |draft: Draft| {
        let blocks = draft
            .blocks
            .iter()
            .map(|block| Block { bytes: [0, 0x7e].repeat(block.bytes.len() / 2), ..block.clone() })
            .collect();
        Draft { blocks, ..draft }
    };
    draft("all_nan", nan(Draft::good()), "not one pixel");

    // Blocks and their positions.
    let places = Draft::good().places();
    let offsets = |offsets: Vec<u64>| Draft { offsets: Some(offsets), ..Draft::good() };
    draft("offsets_missing", offsets(vec![places[0], 0, places[2]]), "block (0, 1) is missing");
    draft("offsets_swapped", offsets(vec![places[1], places[0], places[2]]), "is another one");
    draft("offsets_equal", offsets(vec![places[0], places[1], places[1]]), "two blocks");
    draft("offsets_beyond", offsets(vec![places[0], places[1], u64::MAX]), "but none can");
    draft("offsets_in_header", offsets(vec![places[0], places[1], 8]), "but none can");
    draft("offsets_too_few", offsets(vec![places[0], places[1]]), "block");
    let block = |change: &dyn Fn(&mut Block)| {
        let mut draft = Draft::good();
        change(&mut draft.blocks[1]);
        draft
    };
    draft("block_of_another_row", block(&|block| block.numbers[0] = 7), "is another one");
    draft("block_negative", block(&|block| block.claimed = Some(-1)), "negative size");
    draft("block_huge", block(&|block| block.claimed = Some(i32::MAX)), "larger than its pixels");
    draft("block_empty", block(&|block| block.bytes.clear()), "damaged");
    draft("block_small", block(&|block| block.bytes.truncate(5)), "damaged");
    draft("count_wrong", Draft::good().and("chunkCount", "int", ints(&[99])), "chunk count");
    for (name, method) in [
        ("rle", 1),
        ("zips", 2),
        ("zip", 3),
        ("piz", 4),
        ("pxr24", 5),
        ("b44", 6),
        ("b44a", 7),
        ("dwaa", 8),
        ("dwab", 9),
    ] {
        // Too few bytes for the blocks of B44.
        let noise = (0..if name.starts_with('b') { 10 } else { 100u32 })
            .map(|at| (at.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        // One row per block, and therefore three blocks.
        let one = Draft::compressed(method, noise);
        let several = Draft {
            blocks: (0..HEIGHT).map(|y| Block { numbers: vec![y], ..one.blocks[0].clone() }).collect(),
            ..one.clone()
        };
        draft(&format!("garbage_{name}"), if method < 3 { several } else { one }, "damaged");
    }
    let mut counters = 2u64.to_le_bytes().to_vec();
    (0..10).for_each(|_| counters.extend((1u64 << 40).to_le_bytes()));
    draft("dwaa_claims", Draft::compressed(8, counters), "claims more data");

    // Tiles.
    draft("tiles_of_nothing", tiled(0), "tile");
    draft("tiles_of_2_31", tiled(i32::MAX as u32), "tile");
    draft("tiles_undescribed", Draft { version: [2, 2, 0, 0], ..Draft::good() }, "tiles");

    // Parts.
    draft("parts_of_other_sizes", Draft::of_two_parts([0, 0, 1, HEIGHT - 1]), "its data window is");
    draft("parts_elsewhere", Draft::of_two_parts([5, 0, 8, HEIGHT - 1]), "its data window is");
    let mut swapped = Draft::of_two_parts([0, 0, 3, 2]);
    swapped.blocks.iter_mut().for_each(|block| block.numbers[0] = 1 - block.numbers[0]);
    draft("parts_swapped", swapped, "is another one");
    let mut none = Draft::of_two_parts([0, 0, 3, 2]);
    none.parts.clear();
    draft("parts_none", Draft { blocks: Vec::new(), ..none }, "part");
    corpus
}

fn sampled(steps: [i32; 2]) -> Vec<u8> {
    channel_list(&CHANNELS.map(|name| (name, HALF, steps)))
}

fn tiled(side: u32) -> Draft {
    let mut tiles = [side.to_le_bytes(), side.to_le_bytes()].concat();
    tiles.push(0);
    let mut draft = Draft::good().and("tiles", "tiledesc", tiles);
    draft.version[1] = 2;
    draft.blocks = vec![Block { numbers: vec![0; 4], claimed: None, bytes: vec![0; 144] }];
    draft
}

fn committed() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/broken")
}

/// Returns the error of reading a file and making a frame of it.
fn refusal(path: &Path) -> String {
    match BufferSet::read(&request(path)) {
        Err(error) => {
            assert!(matches!(error, Error::File { .. } | Error::Layer { .. }), "{error:?}");
            let text = error.to_string();
            assert!(text.starts_with(&path.display().to_string()), "{text}");
            text
        }
        Ok(set) => set.to_frame().map(|_| ()).expect_err("something is broken").to_string(),
    }
}

#[test]
fn what_the_broken_files_are_made_from_is_sound() {
    let folder = folder();
    let path = folder.path().join("good.exr");
    let tiles = Draft { blocks: vec![Block { numbers: vec![0; 4], ..Draft::good().blocks[0].clone() }], ..tiled(4) };
    let tiles = Draft {
        blocks: vec![Block {
            bytes: Draft::good().blocks.iter().flat_map(|block| block.bytes.clone()).collect(),
            ..tiles.blocks[0].clone()
        }],
        ..tiles
    };
    let mut pixels = Vec::new();
    for draft in [Draft::good(), tiles, Draft::of_two_parts([0, 0, 3, 2])] {
        std::fs::write(&path, draft.bytes().0).expect("a file");
        let set = BufferSet::read(&request(&path)).expect("nothing is broken");
        assert!(set.to_frame().is_ok());
        pixels.push(set.color().mean);
    }
    assert_eq!(pixels[0], pixels[1]);
}

#[test]
fn each_broken_file_is_refused_with_what_is_wrong_and_what_to_do() {
    let corpus = corpus();
    let remakes = std::env::var_os(REMAKE).is_some();
    if remakes {
        let _ = std::fs::remove_dir_all(committed());
        std::fs::create_dir_all(committed()).expect("a folder");
    }
    let mut wrong = Vec::new();
    for Broken { name, bytes, said } in &corpus {
        let path = committed().join(format!("{name}.exr"));
        if remakes {
            std::fs::write(&path, bytes).expect("a file");
        }
        assert!(
            std::fs::read(&path).is_ok_and(|found| found == *bytes),
            "{name} is not what is made here: {REMAKE}=1 writes all of them anew"
        );
        let text = refusal(&path);
        if !text.contains(said) || !text.contains("remedy: ") {
            wrong.push(format!("{name}: no '{said}' in {text}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let files = std::fs::read_dir(committed()).expect("a folder").count();
    assert_eq!(files, corpus.len(), "a file in testdata/broken is made nowhere");
}

#[test]
fn a_file_is_refused_wherever_it_ends() {
    let folder = folder();
    let path = folder.path().join("cut.exr");
    for draft in [Draft::good(), Draft::of_two_parts([0, 0, 3, 2]), tiled(4)] {
        let whole = draft.bytes().0;
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).expect("a file");
            assert!(refusal(&path).contains("cut.exr"), "at {length}");
        }
    }
}
