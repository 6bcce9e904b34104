//! Writing, row by row from the columns.

use super::{PlyOptions, ScalarColumn};
use crate::scene::{Mesh, PointCloud};
use glam::DVec3;
use ply_rs_bw::ply::{
    Addable, DefaultElement, ElementDef, Encoding, Header, PropertyDef, PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;
use std::io::{Error, ErrorKind, Result, Write};

/// Bytes collected before they are handed on.
const BLOCK: usize = 1 << 16;

/// Rows on their way out, binary or as text.
struct Rows<'a, W: Write> {
    out: &'a mut W,
    options: &'a PlyOptions,
    block: Vec<u8>,
}

impl<'a, W: Write> Rows<'a, W> {
    fn new(out: &'a mut W, options: &'a PlyOptions) -> Self {
        let block = Vec::with_capacity(BLOCK + 256);
        Self {
            out,
            options,
            block,
        }
    }

    /// One value; `binary` are its bytes, little-endian.
    fn put<const N: usize>(
        &mut self,
        value: impl std::fmt::Display,
        binary: [u8; N],
    ) -> Result<()> {
        if self.options.ascii {
            if self.block.last().is_some_and(|&byte| byte != b'\n') {
                self.block.push(b' ');
            }
            return write!(self.block, "{value}");
        }
        self.block.extend_from_slice(&binary);
        Ok(())
    }

    fn byte(&mut self, value: u8) -> Result<()> {
        self.put(value, [value])
    }

    fn int(&mut self, value: u32) -> Result<()> {
        self.put(value, value.to_le_bytes())
    }

    fn float(&mut self, value: f32) -> Result<()> {
        self.put(value, value.to_le_bytes())
    }

    /// A position; text has all digits of the float, as readers may take it for a double.
    fn position(&mut self, position: DVec3) -> Result<()> {
        for value in position.to_array() {
            let float = value as f32;
            match self.options.double {
                true => self.put(value, value.to_le_bytes())?,
                false => self.put(f64::from(float), float.to_le_bytes())?,
            }
        }
        Ok(())
    }

    fn end_row(&mut self) -> Result<()> {
        if self.options.ascii {
            self.block.push(b'\n');
        }
        if self.block.len() >= BLOCK {
            self.out.write_all(&self.block)?;
            self.block.clear();
        }
        Ok(())
    }

    fn finish(self) -> Result<()> {
        self.out.write_all(&self.block)
    }
}

fn element(name: &str, count: usize) -> ElementDef {
    let mut element = ElementDef::new(name.into());
    element.count = count;
    element
}

fn add(element: &mut ElementDef, names: &[&str], scalar: &ScalarType) {
    for name in names {
        let data_type = PropertyType::Scalar(scalar.clone());
        element
            .properties
            .add(PropertyDef::new((*name).into(), data_type));
    }
}

fn add_list(element: &mut ElementDef, name: &str, scalar: ScalarType) {
    let data_type = PropertyType::List(ScalarType::UChar, scalar);
    element
        .properties
        .add(PropertyDef::new(name.into(), data_type));
}

fn position_type(options: &PlyOptions) -> ScalarType {
    if options.double {
        ScalarType::Double
    } else {
        ScalarType::Float
    }
}

fn write_header(
    out: &mut impl Write,
    elements: Vec<ElementDef>,
    options: &PlyOptions,
) -> Result<()> {
    let mut header = Header::new();
    header.encoding = if options.ascii {
        Encoding::Ascii
    } else {
        Encoding::BinaryLittleEndian
    };
    header.comments = options
        .comments
        .iter()
        .map(|comment| comment.replace(['\n', '\r'], " "))
        .collect();
    for element in elements {
        header.elements.add(element);
    }
    Writer::<DefaultElement>::new().write_header(out, &header)?;
    Ok(())
}

/// See [`super::write_cloud`].
pub(super) fn cloud(
    out: &mut impl Write,
    cloud: &PointCloud,
    scalars: &[ScalarColumn<'_>],
    options: &PlyOptions,
) -> Result<()> {
    let vertex = cloud_element(cloud, scalars, options)?;
    write_header(out, vec![vertex], options)?;
    let mut rows = Rows::new(out, options);
    for (index, &position) in cloud.positions().iter().enumerate() {
        rows.position(position)?;
        if let Some(normals) = cloud.normals() {
            normals[index]
                .to_array()
                .into_iter()
                .try_for_each(|value| rows.float(value))?;
        }
        if let Some(colors) = cloud.colors() {
            colors[index]
                .into_iter()
                .try_for_each(|value| rows.byte(value))?;
        }
        if let Some(view_counts) = cloud.view_counts() {
            rows.int(view_counts[index])?;
        }
        if let Some(confidences) = cloud.confidences() {
            rows.float(confidences[index])?;
        }
        scalars
            .iter()
            .try_for_each(|column| rows.float(column.values[index]))?;
        rows.end_row()?;
    }
    rows.finish()
}

fn cloud_element(
    cloud: &PointCloud,
    scalars: &[ScalarColumn<'_>],
    options: &PlyOptions,
) -> Result<ElementDef> {
    let mut vertex = element("vertex", cloud.len());
    add(&mut vertex, &["x", "y", "z"], &position_type(options));
    if cloud.normals().is_some() {
        add(&mut vertex, &["nx", "ny", "nz"], &ScalarType::Float);
    }
    if cloud.colors().is_some() {
        add(&mut vertex, &["red", "green", "blue"], &ScalarType::UChar);
    }
    if cloud.view_counts().is_some() {
        add(&mut vertex, &["views"], &ScalarType::UInt);
    }
    if cloud.confidences().is_some() {
        add(&mut vertex, &["confidence"], &ScalarType::Float);
    }
    for column in scalars {
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let problem = if column.values.len() != cloud.len() {
            format!(
                "has {} values for {} points",
                column.values.len(),
                cloud.len()
            )
        } else if !column.name.chars().all(allowed) || !column.name.starts_with(char::is_alphabetic)
        {
            "is not a name of letters, digits and underscores".into()
        } else if vertex.properties.contains_key(column.name) {
            "is there twice".into()
        } else {
            add(&mut vertex, &[column.name], &ScalarType::Float);
            continue;
        };
        let problem = format!("PLY property `{}` {problem}", column.name);
        return Err(Error::new(ErrorKind::InvalidInput, problem));
    }
    Ok(vertex)
}

/// See [`super::write_mesh`].
pub(super) fn mesh(out: &mut impl Write, mesh: &Mesh, options: &PlyOptions) -> Result<()> {
    write_header(out, mesh_elements(mesh, options), options)?;
    let mut rows = Rows::new(out, options);
    for (index, &position) in mesh.vertices().iter().enumerate() {
        rows.position(position)?;
        if let Some(colors) = mesh.vertex_colors() {
            colors[index]
                .into_iter()
                .try_for_each(|value| rows.byte(value))?;
        }
        rows.end_row()?;
    }
    for (index, triangle) in mesh.triangles().iter().enumerate() {
        rows.byte(3)?;
        triangle.iter().try_for_each(|&vertex| rows.int(vertex))?;
        if let Some(coords) = mesh.texture_coords() {
            rows.byte(6)?;
            let values = coords[index].iter().flat_map(|corner| corner.to_array());
            values.into_iter().try_for_each(|value| rows.float(value))?;
        }
        if let Some(materials) = mesh.triangle_materials() {
            rows.int(materials[index])?;
        }
        rows.end_row()?;
    }
    rows.finish()
}

fn mesh_elements(mesh: &Mesh, options: &PlyOptions) -> Vec<ElementDef> {
    let mut vertex = element("vertex", mesh.vertices().len());
    add(&mut vertex, &["x", "y", "z"], &position_type(options));
    if mesh.vertex_colors().is_some() {
        add(&mut vertex, &["red", "green", "blue"], &ScalarType::UChar);
    }
    let mut face = element("face", mesh.triangles().len());
    add_list(&mut face, "vertex_indices", ScalarType::Int);
    if mesh.texture_coords().is_some() {
        add_list(&mut face, "texcoord", ScalarType::Float);
    }
    if mesh.triangle_materials().is_some() {
        add(&mut face, &["texnumber"], &ScalarType::Int);
    }
    vec![vertex, face]
}
