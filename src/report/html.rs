//! One page that holds a whole report and opens from disk without a network: everything is inlined.

use super::cloud_payload::{Payload, base64, pack};
use super::curve_svg::escaped;
use super::leaderboard::Metric;
use super::table::{Emphasis, Table};
use crate::error::{Error, Result};
use glam::DVec3;
use serde::Serialize;
use std::fmt::Write;

/// Points of one cloud, and of all clouds of a page.
const POINTS_PER_CLOUD: usize = 200_000;
const POINTS_PER_PAGE: usize = 1_000_000;
/// No page is larger.
const MOST_BYTES: usize = 10_000_000;
/// Notes below one table; files of tables have all of them.
const NOTES: usize = 20;
/// What stands around the plots of a page, at most.
const PLOTS_FRAME: usize = 100;

/// What a page shows. Every part may be empty.
#[derive(Debug, Clone, Copy, Default)]
pub struct Page<'a> {
    /// The page's heading and title.
    pub title: &'a str,
    /// A sentence or two below it.
    pub lead: &'a str,
    /// Tables, each under its own title. Those with one row per method can be sorted.
    pub tables: &'a [Table],
    /// Plots.
    pub plots: &'a [Plot],
    /// Clouds to turn in 3-D.
    pub clouds: &'a [PackedCloud],
    /// The first cloud as a PNG, for readers without scripts or WebGL.
    pub still: Option<&'a [u8]>,
    /// Pictures.
    pub pictures: &'a [Picture],
    /// Names and values: command, revision, machine, inputs.
    pub provenance: &'a [(String, String)],
}

/// A picture made of lines.
#[derive(Debug, Clone)]
pub struct Plot {
    /// What it shows, in words.
    pub caption: String,
    /// The SVG.
    pub svg: String,
}

/// A picture made of pixels.
#[derive(Debug, Clone)]
pub struct Picture {
    /// What it shows, in words.
    pub caption: String,
    /// `image/png` or `image/jpeg`.
    pub media_type: &'static str,
    /// The encoded picture.
    pub bytes: Vec<u8>,
}

/// Points and how far each is from the other cloud.
#[derive(Debug, Clone, Copy)]
pub struct ErrorCloud<'a> {
    /// What it is: `Barn, precision`.
    pub name: &'a str,
    /// Positions in `unit`, +Z up.
    pub positions: &'a [DVec3],
    /// Distances in `unit`, one per position.
    pub distances: &'a [f64],
    /// The threshold in `unit`, > 0.
    pub tau: f64,
    /// The unit; may be empty.
    pub unit: &'a str,
}

/// A cloud as the page holds it: thinned and packed.
#[derive(Debug, Clone, PartialEq)]
pub struct PackedCloud {
    name: String,
    unit: String,
    tau: f64,
    payload: Payload,
    /// Points before thinning.
    all: usize,
}

impl PackedCloud {
    /// Says how many points are left out for being far from the others, where any are.
    fn left_out(&self) -> String {
        match self.payload.far {
            0 => String::new(),
            far => format!(", {far} far from the others left out"),
        }
    }

    /// The share of `cloud` in a page of `clouds` clouds.
    ///
    /// # Errors
    /// No points, not one distance for each, and a threshold that is not finite and above 0.
    pub fn new(cloud: &ErrorCloud<'_>, clouds: usize) -> Result<Self> {
        check(cloud)?;
        let most = POINTS_PER_CLOUD.min(POINTS_PER_PAGE / clouds.max(1));
        Ok(Self {
            name: cloud.name.to_owned(),
            unit: cloud.unit.to_owned(),
            tau: cloud.tau,
            payload: pack(cloud.positions, cloud.distances, cloud.tau, most),
            all: cloud.positions.len(),
        })
    }
}

/// What the viewer must know of a cloud.
#[derive(Debug, Serialize)]
struct CloudFacts<'a> {
    middle: [f64; 3],
    tau: f64,
    unit: &'a str,
}

/// The page.
///
/// # Errors
/// More than 10 MB: fewer pictures or clouds then, on several pages.
pub fn html(page: &Page) -> Result<String> {
    let text = unbounded(page)?;
    if text.len() > MOST_BYTES {
        let problem = format!(
            "expected at most {MOST_BYTES} bytes, found {}; give it fewer pictures or clouds",
            text.len()
        );
        return Err(Error::invalid("page", problem));
    }
    Ok(text)
}

/// The bytes that `page` leaves for plots; see [`plot_bytes`].
///
/// # Errors
/// Never: only too large a page is refused, by [`html`].
pub fn room(page: &Page) -> Result<usize> {
    Ok(MOST_BYTES.saturating_sub(unbounded(page)?.len() + PLOTS_FRAME))
}

/// The bytes that a plot takes in a page.
pub fn plot_bytes(plot: &Plot) -> usize {
    let mut text = String::new();
    push_plot(&mut text, plot);
    text.len()
}

fn unbounded(page: &Page) -> Result<String> {
    let title = escaped(page.title);
    let mut text = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <link rel=\"icon\" href=\"data:,\">\n<title>{title}</title>\n<style>\n{}</style>\n</head>\n\
         <body>\n<main>\n<h1>{title}</h1>\n",
        include_str!("page.css")
    );
    if !page.lead.is_empty() {
        push(
            &mut text,
            format_args!("<p class=\"lead\">{}</p>", escaped(page.lead)),
        );
    }
    push_tables(&mut text, page.tables);
    push_plots(&mut text, page.plots);
    push_clouds(&mut text, page.clouds, page.still)?;
    push_pictures(&mut text, page.pictures);
    push_provenance(&mut text, page.provenance);
    push(
        &mut text,
        format_args!(
            "</main>\n<noscript><p class=\"note\">Scripts are off: tables cannot be sorted and clouds \
             cannot be turned; all numbers are here.</p></noscript>\n<script>\n{}</script>\n</body>\n</html>",
            include_str!("page.js")
        ),
    );
    Ok(text)
}

/// Appends a line. Writing to a `String` cannot fail.
fn push(text: &mut String, line: std::fmt::Arguments) {
    let _ = text.write_fmt(line);
    text.push('\n');
}

fn push_tables(text: &mut String, tables: &[Table]) {
    if tables.is_empty() {
        return;
    }
    push(
        text,
        format_args!("<h2>Leaderboards</h2>\n<div class=\"tables\">"),
    );
    for table in tables {
        let class = match table.header.len() {
            ..=6 => "",
            7..=16 => "wide",
            _ => "wide wider",
        };
        push(text, format_args!("<section class=\"{class}\">"));
        push_table(text, table);
        push(text, format_args!("</section>"));
    }
    push(text, format_args!("</div>"));
}

fn push_table(text: &mut String, table: &Table) {
    let sortable = table.rows_per_method <= 1;
    let class = if sortable { " class=\"sortable\"" } else { "" };
    let of_distances = Metric::ALL.iter().any(|metric| {
        let named = ("metric".to_owned(), metric.name().to_owned());
        !metric.is_fraction() && table.identity.contains(&named)
    });
    let title = escaped(&table.title);
    push(text, format_args!("<h3>{title}</h3>"));
    push(
        text,
        format_args!(
            "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{title}\">"
        ),
    );
    push(text, format_args!("<table{class}>\n<thead><tr>"));
    for (column, name) in table.header.iter().enumerate() {
        let class = if column == 0 { " class=\"name\"" } else { "" };
        // Ranks, names and distances are asked for from the smallest, other scores from the largest.
        let first = if column < 3 || of_distances {
            "up"
        } else {
            "down"
        };
        let name = escaped(name);
        let label = if sortable {
            format!("<button>{name}</button>")
        } else {
            name
        };
        push(
            text,
            format_args!("<th scope=\"col\"{class} data-first=\"{first}\">{label}</th>"),
        );
    }
    push(text, format_args!("</tr></thead>\n<tbody>"));
    for (index, row) in table.rows.iter().enumerate() {
        let cells = row.iter().enumerate().map(|(column, cell)| {
            let label = if column == 0 {
                table.label_of(index)
            } else {
                &cell.text
            };
            let class = match (column, cell.emphasis) {
                (0, _) => " class=\"name\"",
                (_, Emphasis::Best) => " class=\"best\"",
                (_, Emphasis::Second) => " class=\"second\"",
                (_, Emphasis::Plain) => "",
            };
            let label = escaped(label);
            match column {
                0 => format!("<th scope=\"row\"{class}>{label}</th>"),
                _ => format!("<td{class}>{label}</td>"),
            }
        });
        push(text, format_args!("<tr>{}</tr>", cells.collect::<String>()));
    }
    push(text, format_args!("</tbody>\n</table>\n</div>"));
    push_notes(text, &table.notes);
}

/// As many as a reader goes through: those of hundreds of failures would fill the page.
fn push_notes(text: &mut String, notes: &[String]) {
    let more = notes.len().saturating_sub(NOTES);
    let more = (more > 0).then(|| format!("And {more} more notes, in leaderboard.md."));
    for note in notes.iter().take(NOTES).chain(&more) {
        push(
            text,
            format_args!("<p class=\"note\">{}</p>", escaped(note)),
        );
    }
}

fn push_figure(text: &mut String, media_type: &str, bytes: &[u8], caption: &str) {
    let (data, caption) = (base64(bytes), escaped(caption));
    push(
        text,
        format_args!(
            "<figure><img alt=\"{caption}\" src=\"data:{media_type};base64,{data}\">\
             <figcaption>{caption}</figcaption></figure>"
        ),
    );
}

fn push_plots(text: &mut String, plots: &[Plot]) {
    if plots.is_empty() {
        return;
    }
    push(
        text,
        format_args!("<h2>Curves</h2>\n<div class=\"figures\">"),
    );
    for plot in plots {
        push_plot(text, plot);
    }
    push(text, format_args!("</div>"));
}

fn push_plot(text: &mut String, plot: &Plot) {
    push_figure(text, "image/svg+xml", plot.svg.as_bytes(), &plot.caption);
}

fn push_pictures(text: &mut String, pictures: &[Picture]) {
    if pictures.is_empty() {
        return;
    }
    push(text, format_args!("<h2>Pictures</h2>"));
    for picture in pictures {
        push_figure(text, picture.media_type, &picture.bytes, &picture.caption);
    }
}

fn push_provenance(text: &mut String, provenance: &[(String, String)]) {
    if provenance.is_empty() {
        return;
    }
    push(text, format_args!("<h2>Provenance</h2>\n<dl>"));
    for (name, value) in provenance {
        push(
            text,
            format_args!("<dt>{}</dt><dd>{}</dd>", escaped(name), escaped(value)),
        );
    }
    push(text, format_args!("</dl>"));
}

fn push_clouds(text: &mut String, clouds: &[PackedCloud], still: Option<&[u8]>) -> Result<()> {
    if clouds.is_empty() {
        return Ok(());
    }
    let (mut facts, mut options, mut data) = (Vec::new(), String::new(), String::new());
    for (index, cloud) in clouds.iter().enumerate() {
        let payload = &cloud.payload;
        let (name, kept, all) = (escaped(&cloud.name), payload.count, cloud.all);
        push(
            &mut options,
            format_args!(
                "<option value=\"{index}\">{name} ({kept} of {all} points{})</option>",
                cloud.left_out()
            ),
        );
        let coded = base64(&payload.bytes);
        push(
            &mut data,
            format_args!("<script type=\"text/plain\" id=\"cloud-{index}\">{coded}</script>"),
        );
        facts.push(CloudFacts {
            middle: payload.middle,
            tau: cloud.tau,
            unit: &cloud.unit,
        });
    }
    let facts =
        serde_json::to_string(&facts).map_err(|error| Error::invalid("page", error.to_string()))?;
    // A text in the facts must not close the script element.
    let facts = facts.replace('<', "\\u003c");
    push(
        text,
        format_args!("<h2>Errors in 3-D</h2>\n<div class=\"viewer\">"),
    );
    push_still(text, &clouds[0], still);
    push(text, format_args!("{VIEWER_HEAD}{options}{VIEWER_TAIL}"));
    push(
        text,
        format_args!("<script type=\"application/json\" id=\"clouds\">{facts}</script>\n{data}"),
    );
    Ok(())
}

/// What stands in the viewer's place until its script takes over.
fn push_still(text: &mut String, cloud: &PackedCloud, still: Option<&[u8]>) {
    let (name, left_out) = (escaped(&cloud.name), cloud.left_out());
    let picture = still.map_or_else(String::new, |png| {
        let data = base64(png);
        format!("<img alt=\"{name}, coloured by error\" src=\"data:image/png;base64,{data}\">")
    });
    push(
        text,
        format_args!(
            "<figure class=\"fallback\">{picture}<figcaption>{name}{left_out}. Without scripts and WebGL 2 the \
             cloud stands still; the PLY files of this result hold all of it.</figcaption></figure>"
        ),
    );
}

const VIEWER_HEAD: &str = "\
<canvas hidden tabindex=\"0\" role=\"img\" aria-label=\"Point cloud coloured by error. Arrow keys turn it, plus and minus zoom.\"></canvas>\n\
<div class=\"controls\" hidden>\n<label>Cloud <select>\n";
const VIEWER_TAIL: &str = "</select></label>\n\
<label>Full colour at <input type=\"range\" min=\"0.25\" max=\"3\" step=\"0.05\" value=\"1\"> <output></output></label>\n\
<button class=\"plain\" aria-pressed=\"false\">Turn</button>\n\
<div class=\"legend\"><i></i><span><b>0</b><b></b></span></div>\n</div>\n</div>\n\
<p class=\"note\">Drag or use the arrow keys to turn, scroll or + and − to zoom. A cloud of more than its share of points (200 000, or 1 000 000 over all clouds of the page) is thinned to every k-th in Morton order, which keeps its density; the PLY files hold all of them.</p>";

fn check(cloud: &ErrorCloud) -> Result<()> {
    let (points, distances) = (cloud.positions.len(), cloud.distances.len());
    if points != distances || points == 0 || !(cloud.tau > 0.0 && cloud.tau.is_finite()) {
        let problem = format!(
            "expected points, one distance each and a threshold above 0 for {}, found {points}, \
             {distances} and {}",
            cloud.name, cloud.tau
        );
        return Err(Error::invalid("page", problem));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_cannot_break_out_and_nothing_is_fetched() {
        let cloud = ErrorCloud {
            name: "</script><b>",
            positions: &[DVec3::ZERO, DVec3::ONE],
            distances: &[0.0, 1.0],
            tau: 0.5,
            unit: "</script>",
        };
        let page = Page {
            title: "<i>",
            clouds: &[PackedCloud::new(&cloud, 1).unwrap()],
            provenance: &[("command".into(), "a && b".into())],
            ..Page::default()
        };
        let text = html(&page).unwrap();
        assert!(!text.contains("<i>\"") && text.contains("<h1>&lt;i&gt;</h1>"));
        assert_eq!(
            text.matches("</script>").count(),
            3,
            "facts, one cloud, the code"
        );
        assert!(text.contains("a &amp;&amp; b"));
        assert!(!text.contains("src=\"http") && !text.contains("href=\"http"));
        assert!(!text.contains("import ") && !text.contains("fetch("));
    }

    #[test]
    fn the_room_of_a_page_is_what_its_plots_may_take() {
        let plot = |bytes: usize| Plot {
            caption: "<x>".into(),
            svg: "x".repeat(bytes),
        };
        let empty = Page::default();
        let room = room(&empty).unwrap();
        let fits = plot(3 * (room / 4) - 900);
        assert!(plot_bytes(&fits) <= room && plot_bytes(&plot(3 * (room / 4))) > room);
        let plots = [fits];
        let page = Page {
            plots: &plots,
            ..empty
        };
        assert!(html(&page).unwrap().len() > MOST_BYTES - 2000);
    }

    #[test]
    fn what_a_cloud_leaves_out_is_said() {
        let mut positions: Vec<DVec3> = (0..400).map(|i| DVec3::X * f64::from(i)).collect();
        positions.push(DVec3::Y * 1e4);
        let page_of = |count: usize| {
            let cloud = ErrorCloud {
                name: "x",
                positions: &positions[..count],
                distances: &vec![0.0; count],
                tau: 0.5,
                unit: "",
            };
            let clouds = &[PackedCloud::new(&cloud, 1).unwrap()];
            html(&Page {
                clouds,
                ..Page::default()
            })
            .unwrap()
        };
        assert!(!page_of(400).contains("left out"));
        let text = page_of(401);
        let said = "x (400 of 401 points, 1 far from the others left out)</option>";
        assert!(text.contains(said));
        assert!(text.contains("<figcaption>x, 1 far from the others left out. "));
    }

    #[test]
    fn a_table_shows_its_first_notes_and_says_how_many_there_are() {
        let page_of = |notes: usize| {
            let note = |i| format!("note {i} {}", "x".repeat(1000));
            let table = Table {
                notes: (0..notes).map(note).collect(),
                ..Table::default()
            };
            html(&Page {
                tables: &vec![table; 6],
                ..Page::default()
            })
        };
        let whole = page_of(20).unwrap();
        assert!(whole.contains("note 19 ") && !whole.contains("more notes"));
        let cut = page_of(4000).unwrap();
        assert!(cut.contains("note 19 ") && !cut.contains("note 20 "));
        assert_eq!(
            cut.matches("And 3980 more notes, in leaderboard.md.")
                .count(),
            6
        );
    }

    #[test]
    fn clouds_that_do_not_fit_and_pages_too_large_are_refused() {
        let cloud = ErrorCloud {
            name: "x",
            positions: &[DVec3::ZERO],
            distances: &[],
            tau: 1.0,
            unit: "",
        };
        assert!(
            PackedCloud::new(&cloud, 1)
                .unwrap_err()
                .to_string()
                .contains("for x, found 1, 0 and 1")
        );
        let picture = Picture {
            caption: String::new(),
            media_type: "image/png",
            bytes: vec![0; 8_000_000],
        };
        let page = Page {
            pictures: &[picture],
            ..Page::default()
        };
        assert!(
            html(&page)
                .unwrap_err()
                .to_string()
                .contains("at most 10000000 bytes")
        );
    }
}
