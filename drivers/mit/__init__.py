"""The framing of the MIT mini-cheetah motor and of those that took it over, as one protocol with variants."""
