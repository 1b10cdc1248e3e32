//! Offsets of the members of a uniform struct in a shader. Members are found by name and compared by type.

use std::marker::PhantomData;

use naga::{AddressSpace, GlobalVariable, Handle, Module, ScalarKind, Type, TypeInner};

use super::bindings::{Member, Uniform};
use super::shader::compose_source;
use crate::error::{Error, Result};

/// Text that naga_oil puts between the name of an imported item and the name of its module.
const IMPORT_DECORATION: &str = "X_naga_oil_mod_X";

/// Layout of the uniform struct `T` in a shader that the embedding program runs itself, such as one that draws to its
/// window. Kernels need no layout of their own: [`bindings!`](crate::bindings!) makes it.
///
/// ```
/// stein::gpu::uniforms! { struct Fade { color: stein::glam::Vec3, amount: f32 } }
///
/// let source = "
///     struct Fade { amount: f32, color: vec3f }
///     @group(0) @binding(0) var<uniform> fade: Fade;
///     @fragment fn paint() -> @location(0) vec4f { return vec4f(fade.color, fade.amount); }";
/// let layout = stein::gpu::UniformLayout::<Fade>::from_source("fade", source, "fade")?;
/// let bytes = layout.encode(&Fade { color: stein::glam::Vec3::ONE, amount: 0.5 });
/// assert_eq!((bytes.len() as u64, layout.bytes()), (32, 32));
/// assert_eq!(bytes[..4], 0.5_f32.to_ne_bytes());
/// # Ok::<_, stein::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UniformLayout<T> {
    bytes: u32,
    offsets: Vec<u32>,
    host: PhantomData<fn(&T)>,
}

impl<T: Uniform> UniformLayout<T> {
    /// Finds the members of `T` in the variable `var<uniform> variable` of a WGSL source. `name` stands for the shader
    /// in errors.
    ///
    /// # Errors
    /// [`Error::Shader`] if the source does not compile, if it has no such variable, or if names or types of the
    /// members differ between `T` and the shader.
    pub fn from_source(name: &str, source: &str, variable: &str) -> Result<Self> {
        let module = compose_source(name, source, &[])?;
        let is_the_variable = |global: &&GlobalVariable| {
            global.space == AddressSpace::Uniform && undecorated(global.name.as_deref()) == variable
        };
        let path = std::any::type_name::<T>();
        let host = path.rsplit_once("::").map_or(path, |(_, host)| host);
        let layout = match module.global_variables.iter().map(|(_, global)| global).find(is_the_variable) {
            Some(global) => lay_out(&module, global, host, T::members),
            None => Err(format!("the shader has no 'var<uniform> {variable}'")),
        };
        let (bytes, offsets) = layout.map_err(|problem| Error::Shader { stage: name.into(), problem })?;
        Ok(Self { bytes, offsets, host: PhantomData })
    }

    /// Returns the size of the struct in the shader, in bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes.into()
    }

    /// Returns the bytes of a value as the shader reads them: each member at its offset, and 0 between the members.
    pub fn encode(&self, value: &T) -> Vec<u8> {
        let mut members = Vec::new();
        value.bytes(&mut members);
        let mut encoded = vec![0; self.bytes as usize];
        for (offset, member) in self.offsets.iter().zip(members) {
            encoded[*offset as usize..][..member.len()].copy_from_slice(member);
        }
        encoded
    }
}

/// Returns the size of a uniform struct and the offset of each member in the order of the host's table, all in bytes.
/// Fails if names or types of the members differ.
pub(super) fn lay_out(
    module: &Module,
    global: &GlobalVariable,
    host: &str,
    members: fn(&str, &mut Vec<Member>),
) -> std::result::Result<(u32, Vec<u32>), String> {
    let name = undecorated(global.name.as_deref());
    let (mut wanted, mut found) = (Vec::new(), Vec::new());
    members(name, &mut wanted);
    flatten(module, global.ty, name, 0, &mut found);
    Ok((module.types[global.ty].inner.size(module.to_ctx()), match_members(host, &wanted, &found)?))
}

/// Returns a name without the addition that naga_oil makes to names of imported pieces.
pub(super) fn undecorated(name: Option<&str>) -> &str {
    let name = name.unwrap_or_default();
    name.split_once(IMPORT_DECORATION).map_or(name, |(plain, _)| plain)
}

/// Member of a uniform struct with its offset in the shader, in bytes.
struct Laid {
    path: String,
    value: String,
    offset: u32,
}

fn flatten(module: &Module, ty: Handle<Type>, path: &str, offset: u32, into: &mut Vec<Laid>) {
    match &module.types[ty].inner {
        TypeInner::Struct { members, .. } => {
            for member in members {
                flatten(
                    module,
                    member.ty,
                    &format!("{path}.{}", undecorated(member.name.as_deref())),
                    offset + member.offset,
                    into,
                );
            }
        }
        inner => into.push(Laid { path: path.into(), value: written(module, inner), offset }),
    }
}

/// Formats a type as WGSL writes it, for the types that uniforms can have.
fn written(module: &Module, inner: &TypeInner) -> String {
    let scalar = |scalar: &naga::Scalar| {
        let kind = match scalar.kind {
            ScalarKind::Sint => "i",
            ScalarKind::Uint => "u",
            ScalarKind::Float => "f",
            _ => return "bool".to_owned(),
        };
        format!("{kind}{}", u32::from(scalar.width) * 8)
    };
    match inner {
        TypeInner::Scalar(s) => scalar(s),
        TypeInner::Vector { size, scalar: s } => format!("vec{}<{}>", *size as u32, scalar(s)),
        TypeInner::Matrix { columns, rows, scalar: s } => {
            format!("mat{}x{}<{}>", *columns as u32, *rows as u32, scalar(s))
        }
        TypeInner::Array { base, size: naga::ArraySize::Constant(count), .. } => {
            format!("array<{}, {count}>", written(module, &module.types[*base].inner))
        }
        other => format!("{other:?}"),
    }
}

/// Returns the offsets of the host's members in the shader's struct, in bytes.
fn match_members(host: &str, wanted: &[Member], found: &[Laid]) -> std::result::Result<Vec<u32>, String> {
    if let Some(extra) = found.iter().find(|laid| !wanted.iter().any(|member| member.path == laid.path)) {
        return Err(format!("the shader's '{}: {}' is not in the host struct {host}", extra.path, extra.value));
    }
    let offset = |member: &Member| {
        let Some(laid) = found.iter().find(|laid| laid.path == member.path) else {
            return Err(format!("'{}: {}' of the host struct {host} is not in the shader", member.path, member.value));
        };
        if laid.value != member.value.to_string() {
            return Err(format!(
                "'{}' is {} in the shader and {} in the host struct {host}",
                laid.path, laid.value, member.value
            ));
        }
        Ok(laid.offset)
    };
    wanted.iter().map(offset).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uniforms;

    const SOURCE: &str = "
        struct Draw { background: vec4f, first: vec2f, gain: f32, planes: u32 }
        override KIND: u32;
        @group(0) @binding(0) var<uniform> draw: Draw;
        @vertex fn cover() -> @builtin(position) vec4f { return vec4f(0.0); }
        @fragment fn paint() -> @location(0) vec4f { return draw.background * draw.gain + f32(draw.planes + KIND); }";

    uniforms! {
        struct Fits { planes: u32, first: glam::Vec2, background: glam::Vec4, gain: f32 }
        struct Misnamed { planes: u32, frist: glam::Vec2, background: glam::Vec4, gain: f32 }
        struct Mistyped { planes: f32, first: glam::Vec2, background: glam::Vec4, gain: f32 }
        struct Lacking { planes: u32, first: glam::Vec2, gain: f32 }
    }

    fn problem<T: Uniform>(variable: &str) -> String {
        match UniformLayout::<T>::from_source("draw", SOURCE, variable) {
            Ok(_) => "it fits".into(),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn members_are_written_where_the_shader_reads_them() {
        let layout = UniformLayout::<Fits>::from_source("draw", SOURCE, "draw").expect("it fits");
        assert_eq!((layout.bytes, &layout.offsets[..]), (32, &[28, 16, 0, 24][..]));
        let value = Fits { planes: 3, first: glam::vec2(0.5, 2.0), background: glam::Vec4::ONE, gain: 4.0 };
        let expected: [f32; 8] = [1.0, 1.0, 1.0, 1.0, 0.5, 2.0, 4.0, f32::from_bits(3)];
        assert_eq!(layout.encode(&value), bytemuck::cast_slice::<f32, u8>(&expected));
    }

    #[test]
    fn a_wrong_name_or_type_is_refused() {
        let told = [
            (problem::<Misnamed>("draw"), "'draw.first: vec2<f32>' is not in the host struct Misnamed"),
            (problem::<Mistyped>("draw"), "'draw.planes' is u32 in the shader and f32 in the host struct Mistyped"),
            (problem::<Lacking>("draw"), "'draw.background: vec4<f32>' is not in the host struct Lacking"),
            (problem::<Fits>("drawn"), "the shader has no 'var<uniform> drawn'"),
        ];
        for (told, expected) in told {
            assert!(told.contains(expected), "{told}");
        }
    }
}
