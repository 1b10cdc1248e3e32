//! OpenEXR files made byte by byte, so that each can be broken in one place.

#[derive(Clone)]
pub(crate) struct Attribute {
    pub(crate) name: &'static str,
    pub(crate) kind: &'static str,
    pub(crate) value: Vec<u8>,
}

/// A block: the numbers before its size, its claimed size, and its bytes.
#[derive(Clone)]
pub(crate) struct Block {
    pub(crate) numbers: Vec<i32>,
    pub(crate) claimed: Option<i32>,
    pub(crate) bytes: Vec<u8>,
}

#[derive(Clone)]
pub(crate) struct Draft {
    pub(crate) version: [u8; 4],
    pub(crate) parts: Vec<Vec<Attribute>>,
    pub(crate) blocks: Vec<Block>,
    /// Offsets to write in place of the real ones.
    pub(crate) offsets: Option<Vec<u64>>,
}

pub(crate) const WIDTH: i32 = 4;
pub(crate) const HEIGHT: i32 = 3;

/// Channels: R G B, their variance, and those that a test adds.
pub(crate) const CHANNELS: [&str; 6] = ["B", "G", "R", "variance.B", "variance.G", "variance.R"];

/// A type number: half float.
pub(crate) const HALF: i32 = 1;

pub(crate) fn ints(values: &[i32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Each channel as its name, type, and steps in x and y.
pub(crate) fn channel_list(channels: &[(&str, i32, [i32; 2])]) -> Vec<u8> {
    let mut list = Vec::new();
    for (name, kind, [x, y]) in channels {
        list.extend(name.bytes().chain([0]));
        list.extend(ints(&[*kind, 0, *x, *y]));
    }
    list.push(0);
    list
}

pub(crate) fn channels(names: &[&str]) -> Vec<u8> {
    channel_list(&names.iter().map(|name| (*name, HALF, [1, 1])).collect::<Vec<_>>())
}

fn attribute(name: &'static str, kind: &'static str, value: Vec<u8>) -> Attribute {
    Attribute { name, kind, value }
}

impl Draft {
    /// A valid file: 4×3 pixels, one part, not compressed, a block for each row.
    pub(crate) fn good() -> Self {
        Self::of(&CHANNELS)
    }

    pub(crate) fn of(names: &[&str]) -> Self {
        let window = ints(&[0, 0, WIDTH - 1, HEIGHT - 1]);
        let attributes = vec![
            attribute("channels", "chlist", channels(names)),
            attribute("compression", "compression", vec![0]),
            attribute("dataWindow", "box2i", window.clone()),
            attribute("displayWindow", "box2i", window),
            attribute("lineOrder", "lineOrder", vec![0]),
            attribute("pixelAspectRatio", "float", 1.0f32.to_le_bytes().to_vec()),
            attribute("screenWindowCenter", "v2f", vec![0; 8]),
            attribute("screenWindowWidth", "float", 1.0f32.to_le_bytes().to_vec()),
        ];
        // Half floats from 0.25 to 1, row by row and channel by channel.
        let row = |y: i32| {
            (0..names.len() as i32 * WIDTH)
                .flat_map(|x| (0x3400 + 32 * ((x * 7 + y * 5) % 64)).to_le_bytes()[..2].to_vec())
                .collect()
        };
        let blocks = (0..HEIGHT).map(|y| Block { numbers: vec![y], claimed: None, bytes: row(y) }).collect();
        Self { version: [2, 0, 0, 0], parts: vec![attributes], blocks, offsets: None }
    }

    /// The file with all rows in one block of these bytes.
    pub(crate) fn compressed(method: u8, bytes: Vec<u8>) -> Self {
        let mut draft = Self::good().with("compression", vec![method]);
        draft.blocks = vec![Block { numbers: vec![0], claimed: None, bytes }];
        draft
    }

    /// A file of two parts: the colour, and the variance, which may have another window.
    pub(crate) fn of_two_parts(second_window: [i32; 4]) -> Self {
        let mut draft = Self::of(&CHANNELS[..3]);
        draft.version[1] = 0x10;
        let named = |name: &'static str, window: Vec<u8>| {
            let mut part = draft.parts[0].clone();
            part[2].value = window;
            part.push(attribute("name", "string", name.into()));
            part.push(attribute("type", "string", "scanlineimage".into()));
            part.push(attribute("chunkCount", "int", ints(&[HEIGHT])));
            part
        };
        let parts =
            vec![named("beauty", ints(&[0, 0, WIDTH - 1, HEIGHT - 1])), named("variance", ints(&second_window))];
        let width = (second_window[2] - second_window[0] + 1) as usize;
        let blocks = |part: i32, width: usize| {
            draft.blocks.iter().map(move |block| Block {
                numbers: vec![part, block.numbers[0]],
                claimed: None,
                bytes: block.bytes[..6 * width].to_vec(),
            })
        };
        let blocks = blocks(0, WIDTH as usize).chain(blocks(1, width)).collect();
        Self { parts, blocks, ..draft }
    }

    /// The file with another value for an attribute of all parts, or with one more attribute.
    pub(crate) fn with(mut self, name: &'static str, value: Vec<u8>) -> Self {
        for part in &mut self.parts {
            let found = part.iter_mut().find(|attribute| attribute.name == name);
            found.unwrap_or_else(|| panic!("no {name}")).value.clone_from(&value);
        }
        self
    }

    pub(crate) fn and(mut self, name: &'static str, kind: &'static str, value: Vec<u8>) -> Self {
        self.parts[0].push(attribute(name, kind, value));
        self
    }

    pub(crate) fn without(mut self, name: &str) -> Self {
        self.parts[0].retain(|attribute| attribute.name != name);
        self
    }

    pub(crate) fn window(self, corners: [i32; 4]) -> Self {
        self.with("dataWindow", ints(&corners))
    }

    /// Returns the bytes of the file, and the positions of its parts.
    pub(crate) fn bytes(&self) -> (Vec<u8>, Vec<(String, usize)>) {
        let mut bytes = vec![0x76, 0x2f, 0x31, 0x01];
        let mut marks = vec![("version".to_owned(), bytes.len())];
        bytes.extend(self.version);
        for part in &self.parts {
            for Attribute { name, kind, value } in part {
                marks.push((name.to_string(), bytes.len()));
                bytes.extend(name.bytes().chain([0]).chain(kind.bytes()).chain([0]));
                bytes.extend((value.len() as i32).to_le_bytes());
                bytes.extend(value);
            }
            marks.push(("end of the header".to_owned(), bytes.len()));
            bytes.push(0);
        }
        if self.parts.len() > 1 {
            bytes.push(0);
        }
        marks.push(("offsets".to_owned(), bytes.len()));
        let mut at = (bytes.len() + 8 * self.offsets.as_ref().map_or(self.blocks.len(), Vec::len)) as u64;
        let found = self.blocks.iter().map(|block| {
            let start = at;
            at += (4 * block.numbers.len() + 4 + block.bytes.len()) as u64;
            start
        });
        let offsets = self.offsets.clone().unwrap_or_else(|| found.collect());
        bytes.extend(offsets.iter().flat_map(|offset| offset.to_le_bytes()));
        for (index, Block { numbers, claimed, bytes: content }) in self.blocks.iter().enumerate() {
            marks.push((format!("block {index}"), bytes.len()));
            bytes.extend(ints(numbers));
            bytes.extend(claimed.unwrap_or(content.len() as i32).to_le_bytes());
            marks.push((format!("pixels of block {index}"), bytes.len()));
            bytes.extend(content);
        }
        (bytes, marks)
    }

    /// Positions of the blocks.
    pub(crate) fn places(&self) -> Vec<u64> {
        let marks = self.bytes().1;
        marks.into_iter().filter(|(name, _)| name.starts_with("block")).map(|(_, at)| at as u64).collect()
    }
}
