//! What a pass asks for: references with their sources, and what finished points need.

use super::{Engine, Maps};
use crate::error::Result;
use crate::fuse::cache::Cache;
use crate::fuse::confident::Confident;
use crate::fuse::counts::FuseCounts;
use crate::fuse::finish::Frame;
use crate::fuse::inputs::check_size;
use crate::fuse::options::Colors;
use crate::fuse::points::Columns;
use crate::fuse::reference::{Finish, Reference};
use crate::fuse::rules::Rule;
use crate::fuse::samples::{Filters, Samples, Unit, confidence, prepare};
use crate::fuse::source::{Photo, Source, SourceImage};

impl Engine<'_> {
    /// The view at `index` as a reference, and what the filters left out of it.
    pub(super) fn reference(
        &self,
        index: usize,
        from: Maps,
        rule: Rule,
        cache: &mut Cache<Samples>,
    ) -> Result<(Reference<'_>, FuseCounts)> {
        let maps = self.inputs.maps;
        let view = maps.view(index);
        let listed = maps.sources(index);
        let used = &listed[..self.options.sources_used(listed.len())];
        let mut wanted = used.to_vec();
        wanted.push(index);
        let mut samples = cache.get(&wanted, |source| {
            let samples = self.samples(source, from)?;
            let bytes = samples.bytes();
            Ok((samples, bytes))
        })?;
        let own = samples.split_off(used.len()).remove(0);
        let mut confident = None;
        if from == Maps::Input(Filters::Depth) {
            // References go through all filters.
            let mut room = std::mem::take(&mut *self.spare());
            if room.len() != own.width() * own.height() {
                // Pages that are not touched are not made.
                room = vec![0.0; own.width() * own.height()];
            }
            confident = Confident::read((maps, index), &own, self.options, room)?;
        }
        let counts = own.left_out();
        let source = |(&number, samples)| {
            Source::new(view, (number, maps.view(number)), samples, self.options)
        };
        let reference = Reference {
            number: index,
            view,
            samples: own,
            confident,
            sources: used.iter().zip(samples).map(source).collect(),
            options: self.options,
            rule,
            needed: self.options.sources_needed(used.len()),
            soften: self.options.soften,
        };
        Ok((reference, counts))
    }

    fn samples(&self, index: usize, from: Maps) -> Result<Samples> {
        let pass = match from {
            Maps::Input(filters) => {
                return prepare(self.inputs.maps, index, self.options, filters);
            }
            Maps::Pass(pass) => pass,
        };
        let camera = &self.inputs.maps.view(index).camera;
        let stored = self.inputs.scratch.fetch(self.key(pass, index))?;
        let size = (camera.width(), camera.height());
        let shape = self.shapes().get(&index).cloned();
        Ok(Samples::of_values(
            size,
            Unit::of(self.options),
            shape,
            stored,
        ))
    }

    /// Fetches what finished points need; the sources' images are put into `reference`.
    pub(super) fn finish(
        &self,
        reference: &mut Reference<'_>,
        columns: Columns,
        images: &mut Cache<Photo>,
    ) -> Result<Finish<'_>> {
        let maps = self.inputs.maps;
        let index = reference.number;
        let mut photo = None;
        if columns.has(Columns::COLORS) {
            let mut wanted = vec![index];
            if self.options.colors == Colors::Mean {
                wanted.extend(reference.sources.iter().map(|source| source.number));
            }
            let samples = |at: usize| {
                let source = reference.sources.iter().find(|source| source.number == at);
                source.map_or(&reference.samples, |source| &source.samples)
            };
            let mut found = images
                .get(&wanted, |at| self.photo(at, samples(at)))?
                .into_iter();
            photo = found.next();
            for (source, photo) in reference.sources.iter_mut().zip(found) {
                source.image = Some(SourceImage::new(photo, &source.samples));
            }
        }
        let mut own = None;
        if reference.confident.is_none() && columns.has(Columns::CONFIDENCES) {
            own = confidence(maps, index)?;
        }
        if let (Some(own), true) = (&mut own, self.options.fills()) {
            // Where the filters left no depth it was filled in, and what stands there is not its confidence.
            let input = prepare(maps, index, self.options, Filters::All)?;
            let width = input.width();
            for (at, own) in own.values_mut().iter_mut().enumerate() {
                let had = input.get(at % width, at / width) > 0.0;
                *own = if had { *own } else { 0.0 };
            }
        }
        let normals = maps
            .normals(index)?
            .filter(|_| columns.has(Columns::NORMALS));
        if let Some(normals) = &normals {
            check_size(reference.view, normals.size(), "normal map")?;
        }
        Ok(Finish {
            frame: Frame::new(reference.view),
            centers: reference
                .sources
                .iter()
                .map(|source| source.center)
                .collect(),
            columns,
            as_bytes: None,
            photo,
            confidence: own,
            normals,
            region: self.inputs.region,
        })
    }

    fn photo(&self, index: usize, samples: &Samples) -> Result<(Photo, usize)> {
        let wanted = |size| Photo::window(size, samples);
        let Some((size, part)) = self.inputs.maps.image_part(index, &wanted)? else {
            let view = format!("view {}", self.inputs.maps.view(index).id);
            return Err(crate::Error::invalid(view, "expected an image, found none"));
        };
        let photo = Photo::new((size, part), samples);
        let bytes = photo.part.values().len() * 3;
        Ok((photo, bytes))
    }
}
