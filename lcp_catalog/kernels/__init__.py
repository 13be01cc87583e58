from .cpu_level import use_level

use_level()
