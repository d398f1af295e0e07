"""Reports and figures of results."""

from .adaptation import adaptation_page as adaptation_page
from .adaptation import report_adaptation as report_adaptation
from .heat_map import heat_pictures as heat_pictures
from .learning.learned import report_learning as report_learning
from .limit_pictures import draw_limits as draw_limits
from .motion_strip import draw_strip as draw_strip
from .scores import score_meshes as score_meshes
from .scores import total_scores as total_scores
from .weights import weight_pictures as weight_pictures
