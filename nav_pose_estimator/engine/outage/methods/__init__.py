"""Ways through an outage, one file each; ``registry`` lists them and ``method`` says what each has to offer."""
