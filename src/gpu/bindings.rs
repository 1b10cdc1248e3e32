//! Host structs that name what a shader binds.
//!
//! [`bindings!`](crate::bindings!) declares a struct whose fields are called like the shader's global variables,
//! [`uniforms!`](crate::uniforms!) one whose fields are called like the members of a uniform struct. Both leave a table
//! of names and types, which is compared with the compiled shader when a kernel is built. Binding numbers, member
//! offsets and padding are taken from the shader, so they are written once and cannot disagree.

use std::fmt;

use glam::UVec2;

use super::pool::Buffer;
use super::reach::{Parts, Reach};

/// Values that the host binds to one shader stage. Implemented by [`bindings!`](crate::bindings!).
pub trait Bindings {
    /// The shader's global variables in the order of [`Bindings::values`].
    const SLOTS: &'static [Slot];
    /// Returns the values to bind, in the order of [`Bindings::SLOTS`].
    fn values(&self) -> Vec<Value<'_>>;
}

/// One global variable of a shader, as the host sees it.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    /// The name of the variable.
    pub name: &'static str,
    /// Kind of value that the host binds to the variable.
    pub kind: SlotKind,
}

/// Kind of value that the host binds to a variable, and the access that the shader has to it.
#[derive(Clone, Copy)]
pub enum SlotKind {
    /// `var<uniform>`, filled from a struct made by [`uniforms!`](crate::uniforms!).
    Uniform {
        /// The name of the host struct.
        host: &'static str,
        /// Function that lists the members of the struct.
        members: fn(&str, &mut Vec<Member>),
    },
    /// `var<storage, read>`.
    Read,
    /// `var<storage, read>` that some definitions remove from the shader: bound where it is declared, absent where it
    /// is not.
    Optional,
    /// `var<storage, read_write>`.
    Write,
}

impl SlotKind {
    /// Returns the WGSL declaration that this kind stands for.
    pub(super) fn declaration(self) -> &'static str {
        match self {
            Self::Uniform { .. } => "var<uniform>",
            Self::Read | Self::Optional => "var<storage, read>",
            Self::Write => "var<storage, read_write>",
        }
    }
}

impl PartialEq for SlotKind {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Uniform { host: a, .. }, Self::Uniform { host: b, .. }) => a == b,
            _ => std::mem::discriminant(self) == std::mem::discriminant(other),
        }
    }
}

impl PartialEq for Slot {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name && self.kind == other.kind
    }
}

impl fmt::Debug for SlotKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.declaration())
    }
}

/// Value that one dispatch binds to a slot.
#[derive(Clone, Debug)]
pub enum Value<'a> {
    /// The members of a uniform struct as bytes, in the order of its table.
    Uniform(Vec<&'a [u8]>),
    /// A storage buffer, and how far around a pixel the stage looks in it.
    Buffer(Around<'a>),
    /// Nothing: an [`SlotKind::Optional`] slot that is `None`.
    Absent,
}

/// A buffer together with the distance around each pixel within which a stage reads it; [`Buffer::within`] makes one.
/// Nothing enforces the distance: a dry run adds up the distances of a chain of stages to find how far a result depends
/// on the frame around a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Around<'a> {
    pub(super) buffer: &'a Buffer,
    /// Parts of the buffer that the stage reads; for a [`SlotKind::Write`] also the parts that it writes.
    pub(super) parts: Parts,
    /// Columns and rows beside a pixel that the stage reads to compute the front, and the back, of its output.
    pub(super) radii: Reach,
}

impl<'a> From<&'a Buffer> for Around<'a> {
    fn from(buffer: &'a Buffer) -> Self {
        Self { buffer, parts: Parts::Whole, radii: Reach::default() }
    }
}

impl Buffer {
    /// Declares that a stage reads this buffer in the square of 2·`radius`+1 pixels around each pixel.
    pub fn within(&self, radius: u32) -> Around<'_> {
        self.within_columns_and_rows(radius, radius)
    }

    /// Declares that a stage reads this buffer at most this many columns and rows away from each pixel.
    pub fn within_columns_and_rows(&self, columns: u32, rows: u32) -> Around<'_> {
        let radius = UVec2::new(columns, rows);
        Around { buffer: self, parts: Parts::Whole, radii: Reach { front: radius, back: radius } }
    }

    /// Declares that a stage reads at different distances around a pixel to compute the front and the back of this
    /// buffer, so that each part gets a reach of its own.
    pub fn in_parts(&self) -> Around<'_> {
        Around { parts: Parts::Apart, ..self.into() }
    }
}

impl Around<'_> {
    /// Declares that a stage reads only the front of this buffer, such as the mean of a signal.
    #[must_use]
    pub fn front(self) -> Self {
        Self { parts: Parts::Front, ..self }
    }

    /// Declares that a stage reads only the back of this buffer, such as the half spread of a signal.
    #[must_use]
    pub fn back(self) -> Self {
        Self { parts: Parts::Back, ..self }
    }

    /// Declares that a stage reads this buffer at the pixel alone to compute the front of its output, which it declares
    /// as [written in parts](Buffer::in_parts). To compute the back, it reads this buffer around the pixel.
    #[must_use]
    pub fn but_for_the_front(self) -> Self {
        Self { radii: Reach { front: UVec2::ZERO, ..self.radii }, ..self }
    }
}

/// One member of a uniform struct; members of nested structs are listed as `outer.inner`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    /// Dotted path from the uniform variable.
    pub path: String,
    /// Type of the member; the type in the shader must be equal.
    pub value: ValueType,
}

/// The type of a uniform member, displayed as WGSL writes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ValueType {
    /// `f32`, `u32` or `i32`.
    pub scalar: &'static str,
    /// 1 for a scalar, 2 to 4 for a vector.
    pub lanes: u32,
    /// Number of elements of an array; 0 for a value that is no array.
    pub elements: u32,
}

impl fmt::Display for ValueType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let element =
            if self.lanes == 1 { self.scalar.to_owned() } else { format!("vec{}<{}>", self.lanes, self.scalar) };
        if self.elements == 0 { f.write_str(&element) } else { write!(f, "array<{element}, {}>", self.elements) }
    }
}

/// A value that a uniform buffer can hold: a scalar, a vector, an array of four-component vectors, or a struct made by
/// [`uniforms!`](crate::uniforms!).
pub trait Uniform {
    /// Appends the members of this value to `into`; the value itself is called `path`.
    fn members(path: &str, into: &mut Vec<Member>);
    /// Appends the bytes of each member to `into`, in the order of [`Uniform::members`].
    fn bytes<'a>(&'a self, into: &mut Vec<&'a [u8]>);
}

macro_rules! uniform_value {
    ($($type:ty: $scalar:literal x $lanes:literal;)+) => {$(
        impl Uniform for $type {
            fn members(path: &str, into: &mut Vec<Member>) {
                let value = ValueType { scalar: $scalar, lanes: $lanes, elements: 0 };
                into.push(Member { path: path.to_owned(), value });
            }
            fn bytes<'a>(&'a self, into: &mut Vec<&'a [u8]>) {
                into.push(bytemuck::bytes_of(self));
            }
        }
    )+};
}

uniform_value! {
    f32: "f32" x 1;
    u32: "u32" x 1;
    i32: "i32" x 1;
    glam::Vec2: "f32" x 2;
    glam::Vec3: "f32" x 3;
    glam::Vec4: "f32" x 4;
    glam::UVec2: "u32" x 2;
    glam::UVec3: "u32" x 3;
    glam::UVec4: "u32" x 4;
    glam::IVec2: "i32" x 2;
    glam::IVec3: "i32" x 3;
    glam::IVec4: "i32" x 4;
}

// Only arrays of vectors with four components: the elements of a uniform array lie 16 bytes apart.
macro_rules! uniform_array {
    ($($type:ty: $scalar:literal;)+) => {$(
        impl<const N: usize> Uniform for [$type; N] {
            fn members(path: &str, into: &mut Vec<Member>) {
                let value = ValueType { scalar: $scalar, lanes: 4, elements: N as u32 };
                into.push(Member { path: path.to_owned(), value });
            }
            fn bytes<'a>(&'a self, into: &mut Vec<&'a [u8]>) {
                into.push(bytemuck::cast_slice(self.as_slice()));
            }
        }
    )+};
}

uniform_array! {
    glam::Vec4: "f32";
    glam::UVec4: "u32";
    glam::IVec4: "i32";
}

/// Declares structs that fill uniform buffers: ordinary Rust structs whose fields are called and typed like the members
/// in WGSL.
///
/// ```
/// stein::gpu::uniforms! {
///     /// Parameters of the stage.
///     pub struct BoxParams {
///         /// Width and height in pixels.
///         pub extent: glam::UVec2,
///         /// Half width of the box in pixels.
///         pub radius: u32,
///     }
/// }
/// ```
///
/// Order and padding need not match: each value is written at the offset that the shader declares.
#[macro_export]
macro_rules! uniforms {
    ($($(#[$meta:meta])* $vis:vis struct $name:ident {
        $($(#[$field_meta:meta])* $field_vis:vis $field:ident: $type:ty),+ $(,)?
    })+) => {$(
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        $vis struct $name { $($(#[$field_meta])* $field_vis $field: $type),+ }

        impl $crate::gpu::Uniform for $name {
            fn members(path: &str, into: &mut Vec<$crate::gpu::Member>) {
                $(<$type as $crate::gpu::Uniform>::members(&format!("{path}.{}", stringify!($field)), into);)+
            }
            fn bytes<'a>(&'a self, into: &mut Vec<&'a [u8]>) {
                $($crate::gpu::Uniform::bytes(&self.$field, into);)+
            }
        }
    )+};
}

/// Declares what a shader stage binds: a struct whose fields are called like the shader's global variables.
///
/// `uniform name: Struct` takes a struct made by [`uniforms!`](crate::uniforms!); `read name` and `write name` take a
/// `&Buffer`; `optional name` takes an `Option<&Buffer>` for a variable that is read and that some definitions remove.
///
/// A stage reads these buffers at the pixel that it writes. `around name` and `optional_around name` declare buffers
/// that the stage reads around that pixel; they take an [`Around`](crate::gpu::Around) in place of the `&Buffer`.
/// `change name` declares a buffer that the stage writes, and either reads around the pixel or writes in parts; it
/// takes an `Around`, too.
///
/// ```
/// # stein::gpu::uniforms! { pub struct BoxParams { radius: u32 } }
/// stein::gpu::bindings! {
///     /// Averages over a box.
///     pub struct BoxBlur<'a> { uniform params: BoxParams, around source, optional mask, write blurred }
/// }
/// ```
#[macro_export]
macro_rules! bindings {
    (@type $life:lifetime uniform $type:ty) => { $type };
    (@type $life:lifetime read) => { &$life $crate::gpu::Buffer };
    (@type $life:lifetime around) => { $crate::gpu::Around<$life> };
    (@type $life:lifetime optional_around) => { Option<$crate::gpu::Around<$life>> };
    (@type $life:lifetime change) => { $crate::gpu::Around<$life> };
    (@type $life:lifetime write) => { &$life $crate::gpu::Buffer };
    (@type $life:lifetime optional) => { Option<&$life $crate::gpu::Buffer> };
    (@kind uniform $type:ty) => {
        $crate::gpu::SlotKind::Uniform {
            host: stringify!($type),
            members: <$type as $crate::gpu::Uniform>::members,
        }
    };
    (@kind read) => { $crate::gpu::SlotKind::Read };
    (@kind around) => { $crate::gpu::SlotKind::Read };
    (@kind optional_around) => { $crate::gpu::SlotKind::Optional };
    (@kind change) => { $crate::gpu::SlotKind::Write };
    (@kind write) => { $crate::gpu::SlotKind::Write };
    (@kind optional) => { $crate::gpu::SlotKind::Optional };
    (@value $value:expr, uniform $type:ty) => {{
        let mut bytes = Vec::new();
        $crate::gpu::Uniform::bytes(&$value, &mut bytes);
        $crate::gpu::Value::Uniform(bytes)
    }};
    (@value $value:expr, read) => { $crate::gpu::Value::Buffer($crate::gpu::Around::from($value)) };
    (@value $value:expr, write) => { $crate::gpu::Value::Buffer($crate::gpu::Around::from($value)) };
    (@value $value:expr, around) => { $crate::gpu::Value::Buffer($value) };
    (@value $value:expr, change) => { $crate::gpu::Value::Buffer($value) };
    (@value $value:expr, optional) => {
        $value.map_or($crate::gpu::Value::Absent, |buffer| {
            $crate::gpu::Value::Buffer($crate::gpu::Around::from(buffer))
        })
    };
    (@value $value:expr, optional_around) => { $value.map_or($crate::gpu::Value::Absent, $crate::gpu::Value::Buffer) };
    ($($(#[$meta:meta])* $vis:vis struct $name:ident<$life:lifetime> {
        $($(#[$field_meta:meta])* $kind:ident $field:ident $(: $type:ty)?),+ $(,)?
    })+) => {$(
        $(#[$meta])*
        #[allow(missing_docs, reason = "the fields are the shader's variables and are described there")]
        #[derive(Clone, Copy, Debug)]
        $vis struct $name<$life> { $($(#[$field_meta])* $vis $field: $crate::bindings!(@type $life $kind $($type)?)),+ }

        impl $crate::gpu::Bindings for $name<'_> {
            const SLOTS: &'static [$crate::gpu::Slot] =
                &[$($crate::gpu::Slot { name: stringify!($field), kind: $crate::bindings!(@kind $kind $($type)?) }),+];
            fn values(&self) -> Vec<$crate::gpu::Value<'_>> {
                vec![$($crate::bindings!(@value self.$field, $kind $($type)?)),+]
            }
        }
    )+};
}
