//! Turns WGSL files into validated naga modules.

use std::sync::{LazyLock, Mutex};

use naga_oil::compose::{ComposableModuleDescriptor, Composer, ComposerError, NagaModuleDescriptor, ShaderDefValue};

use super::catalogue::{SHARED, STAGES};
use super::lock;
use crate::error::{Error, Result};

/// Shared pieces that all stages may import, or the reason why they cannot be read. Reading them takes longer than
/// composing most stages, so it is done once in a process.
static PIECES: LazyLock<std::result::Result<Mutex<Pieces>, String>> =
    LazyLock::new(|| Pieces::read(SHARED).map(Mutex::new));

/// The value of a name that shaders test with `#ifdef` and `#if`, or insert with `#{NAME}`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Definition {
    /// `true` defines the name; `false` leaves it undefined, so that `#ifdef` means what it says.
    Bool(bool),
    /// Inserted as a signed integer.
    Int(i32),
    /// Inserted as an unsigned integer.
    UInt(u32),
}

impl From<bool> for Definition {
    fn from(value: bool) -> Self {
        Self::Bool(value)
    }
}

impl From<i32> for Definition {
    fn from(value: i32) -> Self {
        Self::Int(value)
    }
}

impl From<u32> for Definition {
    fn from(value: u32) -> Self {
        Self::UInt(value)
    }
}

/// Names and values that specialise a stage. They are part of a kernel's identity: two sets of definitions are two
/// kernels.
pub type Definitions<'a> = &'a [(&'a str, Definition)];

/// The names of all stages.
pub fn stages() -> Vec<&'static str> {
    STAGES.iter().map(|(name, _)| *name).collect()
}

/// The names of all pieces that stages import, as their files in `shaders/shared/` are called.
pub fn shared_modules() -> Vec<&'static str> {
    SHARED.iter().map(|(name, _)| *name).collect()
}

/// Composes a stage: resolves its imports and definitions, and validates it with naga.
///
/// # Errors
/// [`Error::Shader`] where there is no such stage, where it does not compile, or where neither it nor any shared piece
/// mentions one of the definitions.
pub fn compose(stage: &str, definitions: Definitions) -> Result<naga::Module> {
    let Some((_, source)) = STAGES.iter().find(|(name, _)| *name == stage) else {
        return Err(Error::Shader { stage: stage.into(), problem: "there is no shader of this name".into() });
    };
    compose_source(stage, source, definitions)
}

/// Composes a source that is not in `shaders/`; it may import the shared pieces.
///
/// # Errors
/// As [`compose`].
pub fn compose_source(name: &str, source: &str, definitions: Definitions) -> Result<naga::Module> {
    match &*PIECES {
        Ok(pieces) => lock(pieces).compose(name, source, definitions),
        Err(problem) => Err(problem.clone()),
    }
    .map_err(|problem| Error::Shader { stage: name.into(), problem })
}

/// Shared pieces that stages may import.
pub(super) struct Pieces {
    composer: Composer,
    sources: &'static [(&'static str, &'static str)],
}

impl Pieces {
    /// Adds every piece after the pieces that it imports, which is the order that naga_oil demands.
    pub(super) fn read(sources: &'static [(&str, &str)]) -> std::result::Result<Self, String> {
        let mut composer = Composer::default();
        let mut waiting = sources.to_vec();
        while !waiting.is_empty() {
            let before = waiting.len();
            let mut problem = String::new();
            waiting.retain(|(name, source)| {
                let file = format!("shaders/shared/{name}.wgsl");
                let description = ComposableModuleDescriptor { source, file_path: &file, ..Default::default() };
                match composer.add_composable_module(description) {
                    Ok(_) => false,
                    Err(error) => {
                        problem = told(&error, &composer);
                        true
                    }
                }
            });
            if waiting.len() == before {
                return Err(problem);
            }
        }
        Ok(Self { composer, sources })
    }

    pub(super) fn compose(
        &mut self,
        name: &str,
        source: &str,
        definitions: Definitions,
    ) -> std::result::Result<naga::Module, String> {
        for (definition, _) in definitions {
            // naga_oil ignores names that no shader uses, so a misspelt one would silently build the wrong kernel.
            if !source.contains(definition) && !self.sources.iter().any(|(_, shared)| shared.contains(definition)) {
                return Err(format!("no shader mentions the definition '{definition}'"));
            }
        }
        let defined = definitions.iter().filter_map(|(name, value)| match *value {
            Definition::Bool(false) => None,
            Definition::Bool(true) => Some(((*name).to_owned(), ShaderDefValue::Bool(true))),
            Definition::Int(value) => Some(((*name).to_owned(), ShaderDefValue::Int(value))),
            Definition::UInt(value) => Some(((*name).to_owned(), ShaderDefValue::UInt(value))),
        });
        let file = format!("shaders/{name}.wgsl");
        let description =
            NagaModuleDescriptor { source, file_path: &file, shader_defs: defined.collect(), ..Default::default() };
        self.composer.make_naga_module(description).map_err(|error| told(&error, &self.composer))
    }
}

/// Formats the compiler's message with the source lines that it is about.
fn told(error: &ComposerError, composer: &Composer) -> String {
    error.emit_to_string(composer).trim_end().to_owned()
}
