"""Reports as HTML: report.html of a run and the page of `gscore compare`."""

from .cameras_plan import cameras_section
from .histograms import splat_histograms
from .page import Report, report_html, write_results
from .pictures import PictureCollector
from .transients import MOST_PICTURES, MaskedPhoto
