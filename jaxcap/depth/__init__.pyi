"""Depth images of people: the person in an image, and clouds with their depth images."""

from .background import Background as Background
from .background import estimate_background as estimate_background
from .candidates import Candidate as Candidate
from .clouds import cloud_of_depths as cloud_of_depths
from .floor import find_floor_of_person as find_floor_of_person
from .people import find_people as find_people
from .person import PersonSearch as PersonSearch
from .person import find_person as find_person
from .person import search_person as search_person
from .views import make_depth_view as make_depth_view
