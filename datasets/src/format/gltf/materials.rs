//! Base colours of glTF materials.

use super::GltfImage;
use super::data::{self, Document};
use super::wire::TextureUse;
use crate::scene::srgb;
use glam::Vec2;

/// What triangles of a glTF are made of.
#[derive(Debug, Clone, PartialEq)]
pub struct GltfMaterial {
    /// The material's name; empty when it has none.
    pub name: String,
    /// The base colour factor as 8-bit sRGB: the colour where there is no texture.
    pub color: [u8; 3],
    /// The base colour factor, linear.
    pub factor: [f64; 3],
    /// The base colour texture, to be multiplied with `factor` in linear light.
    pub texture: Option<GltfTexture>,
    /// Whether there are vertex colours: light, to be multiplied with the texture if there is one.
    pub tinted: bool,
    /// The least opacity of the texture, in 0…1, that is surface; `None` for opaque materials.
    pub cutoff: Option<f64>,
    /// Whether both sides are surface.
    pub double_sided: bool,
}

impl Default for GltfMaterial {
    /// glTF's default material: white.
    fn default() -> Self {
        Self {
            name: String::new(),
            color: [255; 3],
            factor: [1.0; 3],
            texture: None,
            tinted: false,
            cutoff: None,
            double_sided: false,
        }
    }
}

/// A texture and how it lies on the surface.
#[derive(Debug, Clone, PartialEq)]
pub struct GltfTexture {
    /// The image's number in the file.
    pub image: usize,
    /// The set of texture coordinates.
    pub set: u32,
    /// `KHR_texture_transform`: offset, rotation in radians, scale.
    pub transform: ([f64; 2], f64, [f64; 2]),
    /// Whether it is repeated in both directions.
    pub repeats: bool,
}

impl GltfTexture {
    /// What a coordinate of the file becomes, with (0, 0) at the bottom-left corner of the image.
    pub(super) fn placement(&self) -> impl Fn(Vec2) -> Vec2 + use<> {
        let (offset, angle, scale) = self.transform;
        let (sin, cos) = libm::sincos(angle);
        move |coord: Vec2| {
            let (u, v) = (f64::from(coord.x) * scale[0], f64::from(coord.y) * scale[1]);
            let x = cos * u + sin * v + offset[0];
            let y = -sin * u + cos * v + offset[1];
            #[allow(
                clippy::cast_possible_truncation,
                reason = "texture coordinates are f32"
            )]
            Vec2::new(x as f32, (1.0 - y) as f32)
        }
    }
}

/// A material, what is to be said about it, and whether nothing of it is there.
#[derive(Debug, Default)]
pub(super) struct Understood {
    pub(super) material: GltfMaterial,
    pub(super) notes: Vec<&'static str>,
    pub(super) is_absent: bool,
    /// Whether it gives off light, which is left out.
    pub(super) shines: bool,
}

pub(super) fn material_of(document: &Document<'_>, index: usize) -> Result<Understood, String> {
    let wire = document.root.materials.get(index);
    let wire = wire.ok_or_else(|| format!("expected material {index}, found none"))?;
    let mut notes = Vec::new();
    let surface = &wire.pbr_metallic_roughness;
    let [r, g, b, opacity] = surface.base_color_factor.unwrap_or([1.0; 4]);
    if wire
        .extensions
        .contains_key("KHR_materials_pbrSpecularGlossiness")
    {
        notes.push("specular-glossiness materials are left out: export metallic-roughness ones");
    }
    let texture = match &surface.base_color_texture {
        None => None,
        Some(used) => texture_of(document, used, &mut notes)?,
    };
    let cutoff = match wire.alpha_mode.as_deref() {
        Some("MASK") => Some(wire.alpha_cutoff.unwrap_or(0.5) / opacity),
        Some("BLEND") => {
            notes.push("transparent (BLEND) materials are shown opaque");
            None
        }
        _ => None,
    };
    Ok(Understood {
        // Without a factor a texture of it gives off nothing.
        shines: wire.emissive_factor.iter().any(|&part| part > 0.0),
        is_absent: cutoff.is_some_and(|cutoff| cutoff.is_nan() || cutoff > 1.0),
        material: GltfMaterial {
            name: wire.name.clone(),
            color: [r, g, b].map(byte_of_linear),
            factor: [r, g, b],
            texture,
            tinted: false,
            cutoff,
            double_sided: wire.double_sided,
        },
        notes,
    })
}

fn texture_of(
    document: &Document<'_>,
    used: &TextureUse,
    notes: &mut Vec<&'static str>,
) -> Result<Option<GltfTexture>, String> {
    let root = &document.root;
    let texture = root.textures.get(used.index);
    let texture = texture.ok_or_else(|| format!("expected texture {}, found none", used.index))?;
    let Some(image) = texture.source else {
        notes.push(match texture.extensions.is_empty() {
            true => "textures without an image show their material's color",
            false => "textures that are no JPEG or PNG (KTX2, WebP) show their material's color",
        });
        return Ok(None);
    };
    let sampler = texture.sampler.and_then(|index| root.samplers.get(index));
    let repeat = |wrap: Option<u32>| wrap.is_none_or(|wrap| wrap == 10497);
    let transform = used.extensions.transform.clone().unwrap_or_default();
    Ok(Some(GltfTexture {
        image,
        set: transform.tex_coord.unwrap_or(used.tex_coord),
        transform: (
            transform.offset.unwrap_or([0.0; 2]),
            transform.rotation,
            transform.scale.unwrap_or([1.0; 2]),
        ),
        repeats: sampler.is_none_or(|sampler| repeat(sampler.wrap_s) && repeat(sampler.wrap_t)),
    }))
}

/// The image of this number.
pub(super) fn image_of(document: &Document<'_>, index: usize) -> Result<GltfImage, String> {
    let image = document.root.images.get(index);
    let image = image.ok_or_else(|| format!("expected image {index}, found none"))?;
    let wrong = |problem| format!("image {index}: {problem}");
    match (&image.uri, image.buffer_view) {
        (Some(uri), _) => match data::data_uri(uri) {
            Some(bytes) => bytes.map(GltfImage::Bytes).map_err(wrong),
            None => Ok(GltfImage::File(data::unescaped(uri))),
        },
        (None, Some(view)) => {
            let (bytes, _) = document.view(view).map_err(wrong)?;
            Ok(GltfImage::Bytes(bytes.to_vec()))
        }
        (None, None) => Err(wrong(
            "expected a uri or a buffer view, found neither".into(),
        )),
    }
}

/// Linear light in 0…1 as 8-bit sRGB.
pub(crate) fn byte_of_linear(value: f64) -> u8 {
    super::super::obj::byte_of_fraction(srgb::encoded(value))
}
