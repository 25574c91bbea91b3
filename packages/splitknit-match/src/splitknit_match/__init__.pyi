"""The door: what users (``__all__``) and the other members may import; all else may change
tomorrow."""

from splitknit_match.evaluation.evaluate import evaluate as evaluate
from splitknit_match.evaluation.pair import compare_results as compare_results
from splitknit_match.gallery.candidates import Candidates as Candidates
from splitknit_match.gallery.gallery import Enrolment as Enrolment
from splitknit_match.gallery.gallery import Gallery as Gallery
from splitknit_match.gallery.gallery import enroll as enroll
from splitknit_match.gallery.identify import Identification as Identification
from splitknit_match.gallery.verbs import identify as identify
from splitknit_match.matching.match import make_template as make_template
from splitknit_match.matching.match import match as match
from splitknit_match.matching.match import prepare as prepare
from splitknit_match.matching.results import Match as Match
from splitknit_match.prints.verbs import make_print as make_print

__version__: str

__all__ = [
    "Candidates",
    "Enrolment",
    "Gallery",
    "Identification",
    "Match",
    "__version__",
    "compare_results",
    "enroll",
    "evaluate",
    "identify",
    "make_print",
    "make_template",
    "match",
    "prepare",
]
